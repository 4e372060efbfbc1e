"""Features of the points of an object, and their mean."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.perception.visual.views import SEEN
from upvl_cli.types import Array, Ints, Ragged


def foreground_points(state: Ints, feature: Array, background: Ints) -> tuple[Ints, Array]:
    """Return the points that a camera sees and that are not background, and their features.

    A box holds road too, and what stands beside a thin object: such points would outvote its own.

    Args:
        state: (n,) state of the points: seen, occluded or without a view.
        feature: (s, d) features of the seen points, in their order.
        background: (n,) 1 background, 0 not, -1 unknown.
    """
    seen = np.flatnonzero(state == SEEN)
    is_foreground = background[seen] == 0
    return seen[is_foreground], feature[is_foreground]


def average_pool(point_feature: Ragged, basis: Basis) -> Ints:
    """Return (b, d) int8, the mean feature of each box, rounded as those of its points; zeros without points.

    Args:
        point_feature: For each of b boxes the (d,) int8 features of its points.
        basis: Basis that the features are stored in.
    """
    total = np.zeros((len(point_feature.count), len(basis.scale)))
    np.add.at(total, point_feature.owner, basis.dequantize(point_feature.values))
    count = point_feature.count[:, None]
    mean = np.asarray(total / np.maximum(count, 1), dtype=np.float32)
    return np.where(count > 0, basis.quantize(mean), np.int8(0))
