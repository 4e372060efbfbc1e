"""What is known of an object from the features of its points."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.types import Array, Ints


def of_objects(state: Ints, feature: Array, background: Ints) -> tuple[Ints, Array]:
    """The points that a camera sees and words do not call background, and their features.

    A box holds road, and what stands beside a thin object: those points would outvote its own.

    Args:
        state: (n,) of the points, as `extract-vl` says.
        feature: (s, d) of those that are seen, in their order.
        background: (n,) 1 background, 0 not, -1 not told, as `mask` says.
    """
    seen = np.flatnonzero(state == SEEN)
    own = background[seen] == 0
    return seen[own], feature[own]


def pooled(of_box: Ints, codes: Ints, boxes: int, basis: Basis) -> Ints:
    """Return (boxes, COMPONENTS) int8, the mean feature of each box, rounded as those of its points; zeros without points.

    Args:
        of_box: (n,) place of the box that each point is in.
        codes: (n, COMPONENTS) int8 features of the points.
        boxes: How many boxes there are.
        basis: What the features are kept in.
    """
    count = np.bincount(of_box, minlength=boxes)
    total = np.zeros((boxes, COMPONENTS))
    np.add.at(total, of_box, basis.dequantize(codes))
    mean = np.asarray(total / np.maximum(count, 1)[:, None], dtype=np.float32)
    return np.where(count[:, None] > 0, basis.quantize(mean), np.int8(0))
