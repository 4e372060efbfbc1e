"""PROVISIONAL stand-in by the lead, so that the stages run: overwrite it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from upvl_cli.types import Floats


def height_above_ground(xyz_ego_m: Floats, *, start_z_m: float, cell_m: float, max_slope: float) -> Floats:
    """(n,) height of each point above the local ground."""
    if not len(xyz_ego_m):
        return np.zeros(0, np.float32)
    cell = np.floor(xyz_ego_m[:, :2] / cell_m).astype(np.int64)
    cell -= cell.min(axis=0)
    shape = tuple(cell.max(axis=0) + 1)
    low = np.full(shape, np.inf)
    np.minimum.at(low, tuple(cell.T), xyz_ego_m[:, 2].astype(np.float64))
    known = np.isfinite(low)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = low[tuple(nearest)]
    smooth = ndimage.percentile_filter(filled, 30, size=9)
    ground = ndimage.median_filter(np.clip(filled, smooth - 0.4, smooth + 0.4), 3)
    return (xyz_ego_m[:, 2] - ground[tuple(cell.T)]).astype(np.float32)
