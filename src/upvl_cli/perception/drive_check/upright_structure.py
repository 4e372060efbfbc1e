"""What stands upright above the road in one sweep: walls, poles, cars; the part that shows how the car moves.

Rings of a LiDAR on the road move with the car, and so do those on a slope: they say that the car stands. So only
points well above the lowest ones near them count, and of them the place in the plane of the road.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.drive_check.motion_config import UprightStructureConfig
from upvl_cli.perception.voxels import row_keys
from upvl_cli.types import Array, Floats

HEIGHT_WEIGHT = 0.5  # of a difference in height beside one in the plane, where a partner is looked for


@dataclass(frozen=True)
class UprightStructure:
    """Voxels of a sweep above the road, in level axes (z up) and metres as far as the unit is known.

    Attributes:
        xyz_m: (n, 3) centroids.
        offset_s: (n,) mean time of their points after the frame's time.
    """

    xyz_m: Floats
    offset_s: Floats

    def __len__(self) -> int:
        return len(self.xyz_m)

    @cached_property
    def tree(self) -> cKDTree:
        """Tree of the voxels, with heights weighted by `HEIGHT_WEIGHT`."""
        return cKDTree(self.search_places(self.xyz_m))

    def thinned(self, total: int) -> UprightStructure:
        """Return an even choice of so many voxels at most."""
        if len(self) <= total:
            return self
        chosen = np.linspace(0, len(self) - 1, total).astype(np.int64)
        return UprightStructure(self.xyz_m[chosen], self.offset_s[chosen])

    @staticmethod
    def search_places(xyz_m: Array) -> Floats:
        """Return (n, 3) places as the tree holds them."""
        return np.asarray(xyz_m * np.array([1.0, 1.0, HEIGHT_WEIGHT]))


def find_structure(level_m: Floats, offset_s: Floats, config: UprightStructureConfig) -> UprightStructure:
    """Return what stands above the road.

    Args:
        level_m: (n, 3) points in level axes: z up, the origin at the sensor or on the road below it.
        offset_s: (n,) time of each point after the frame's time.
        config: Range, heights and voxels.
    """
    range_m = np.hypot(level_m[:, 0], level_m[:, 1])
    near = np.flatnonzero((range_m > config.min_range_m) & (range_m < config.max_range_m))
    xyz_m, offset_s = level_m[near].astype(np.float64), offset_s[near]
    if not len(xyz_m):
        return UprightStructure(np.zeros((0, 3)), np.zeros(0))
    above = xyz_m[:, 2] - _road_z_m(xyz_m, config) > config.min_height_m
    return _thin(xyz_m[above], offset_s[above], config)


def _road_z_m(xyz_m: Floats, config: UprightStructureConfig) -> Floats:
    """Return the (n,) height of the road below each point: a low quantile of its cell, at least the second lowest.

    Reflections give single points below the road, so the lowest one is not the road.
    """
    keys = row_keys(np.floor(xyz_m[:, :2] / config.cell_m).astype(np.int64))
    order = np.lexsort((xyz_m[:, 2], keys))
    begins = np.flatnonzero(np.append(True, np.diff(keys[order]) != 0))
    count = np.diff(np.append(begins, len(order)))
    rank = np.minimum(np.ceil(config.road_quantile * count).astype(np.int64), count - 1)
    road_z_m = np.empty(len(xyz_m))
    road_z_m[order] = np.repeat(xyz_m[order[begins + rank], 2], count)
    return road_z_m


def _thin(xyz_m: Floats, offset_s: Floats, config: UprightStructureConfig) -> UprightStructure:
    """Return one point a voxel; of too many voxels an even choice."""
    if not len(xyz_m):
        return UprightStructure(np.zeros((0, 3)), np.zeros(0))
    keys = row_keys(np.floor(xyz_m / config.voxel_m).astype(np.int64))
    order = np.argsort(keys, kind="stable")
    begins = np.flatnonzero(np.append(True, np.diff(keys[order]) != 0))
    count = np.diff(np.append(begins, len(order)))
    mean = np.add.reduceat(np.column_stack([xyz_m, offset_s])[order], begins) / count[:, None]
    return UprightStructure(mean[:, :3], mean[:, 3]).thinned(config.max_points)
