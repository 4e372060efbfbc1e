"""How well the clouds of one object agree once they are registered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.amodal.track_parts import spread
from upvl_cli.types import Array, Floats

_MOST_CLOUDS, _MOST_POINTS = 10, 200  # a cost limit: more no longer change the median
NONE = -1.0  # tables hold no NaN
_CUT_M = 0.5  # what one sweep shows and another does not is no disagreement


def cloud_residual_m(clouds_m: Sequence[Floats], motions: Mapping[int, Array]) -> float:
    """Return the median over clouds of the mean distance to the densest cloud; -1 for fewer than two clouds.

    Args:
        clouds_m: T clouds (n, 3).
        motions: (4, 4) motion to common axes, for the number of each cloud that is registered.
    """
    numbers = sorted(number for number in motions if len(clouds_m[number]))
    if len(numbers) < 2:
        return NONE
    densest = max(numbers, key=lambda number: len(clouds_m[number]))
    tree = cKDTree(apply(motions[densest], clouds_m[densest]))
    others = [number for number in numbers if number != densest]
    off_m = []
    for place in spread(len(others), _MOST_CLOUDS).tolist():
        cloud = clouds_m[others[place]]
        moved = apply(motions[others[place]], cloud[:: -(-len(cloud) // _MOST_POINTS)])
        off_m.append(np.minimum(tree.query(moved, distance_upper_bound=_CUT_M)[0], _CUT_M).mean())
    return float(np.median(off_m))
