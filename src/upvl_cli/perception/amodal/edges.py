"""Where the points of an object end, in one frame and in most frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.perception.box_fit import trimmed_range
from upvl_cli.types import Array

MIN_EXTENT_POINTS = 3  # fewer points have no extent


def trimmed_edges(clouds_m: Sequence[Array], trim_share: float) -> tuple[Array, Array]:
    """Return (T, 2) lowest and highest x and y of each cloud without stray points; NaN where points are too few.

    Args:
        clouds_m: T clouds (n, 2 or more).
        trim_share: Share of the points left out at each end.
    """
    low, high = np.full((len(clouds_m), 2), np.nan), np.full((len(clouds_m), 2), np.nan)
    for number, cloud in enumerate(clouds_m):
        if len(cloud) >= MIN_EXTENT_POINTS:
            ends = [trimmed_range(cloud[:, axis], trim_share) for axis in range(2)]
            low[number], high[number] = zip(*ends, strict=True)
    return low, high


def trimmed_extent(xy_m: Array, trim_share: float) -> Array:
    """Return (2,) extents of (n, 2) points along x and y without stray points.

    Args:
        xy_m: (n, 2) points, n > 0.
        trim_share: Share of the points left out at each end.
    """
    (back, front), (right, left) = (trimmed_range(xy_m[:, axis], trim_share) for axis in range(2))
    return np.array([front - back, left - right])


def attained(values: Array, min_share: float) -> Array:
    """Return the largest value that a share of the frames attains, and two frames at least.

    Args:
        values: (T, ...) a value of each frame; one with a NaN is left out. Zeros where no frame is left.
        min_share: Share of the frames.
    """
    values = values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))]
    if not len(values):
        return np.zeros(values.shape[1:])
    rank = min(len(values), max(2, int(np.ceil(min_share * len(values)))))
    return np.asarray(np.sort(values, axis=0)[-rank])
