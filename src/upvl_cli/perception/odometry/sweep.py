"""One sweep, prepared for registration: thinned points, and upright structure that fixes a motion over the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.odometry.config import KissIcpConfig, StructureConfig
from upvl_cli.perception.odometry.constant_velocity import compensate_motion
from upvl_cli.perception.voxels import row_keys
from upvl_cli.types import Bools, Floats, Ints

# Voxels of what enters the map and of what is registered (KISS-ICP, III-B).
_MAP_SHARE, _SOURCE_SHARE = 0.5, 1.5


@dataclass(frozen=True)
class Cloud:
    """Points with the time of each.

    Attributes:
        xyz_m: (n, 3) float64 positions in ego axes.
        offset_s: (n,) when each was measured, after the frame's time; zeros where they are motion-compensated.
    """

    xyz_m: Floats
    offset_s: Floats

    def __len__(self) -> int:
        return len(self.xyz_m)

    def __getitem__(self, index: Ints | Bools) -> Cloud:
        return Cloud(self.xyz_m[index], self.offset_s[index])

    def compensated(self, twist: Floats) -> Floats:
        """Return the (n, 3) points as seen from where the car stood at the frame's time.

        Args:
            twist: (6,) velocity (m/s) and turn rate (rad/s) of the car.
        """
        if not self.offset_s.any():
            return self.xyz_m
        return compensate_motion(self.xyz_m, self.offset_s, twist)


@dataclass(frozen=True)
class PreparedSweep:
    """What odometry keeps of a sweep.

    Attributes:
        time_s: Time of the frame.
        map_points: Points that enter the local map.
        source: Points that are registered.
        structure: Points of upright things within the range of judgement.
    """

    time_s: float
    map_points: Cloud
    source: Cloud
    structure: Cloud


def prepare_sweep(
    xyz_ego_m: Floats, offset_s: Floats, time_s: float, icp: KissIcpConfig, structure: StructureConfig
) -> PreparedSweep:
    """Thin a sweep for registration, and find its upright structure.

    Args:
        xyz_ego_m: (n, 3) points in ego axes.
        offset_s: (n,) when each was measured, after the frame's time; zeros where they are motion-compensated.
        time_s: Time of the frame.
        icp: Range and voxels.
        structure: What counts as upright, and its range.
    """
    cloud = _in_range(xyz_ego_m, offset_s, icp)
    map_points = cloud[first_in_voxels(cloud.xyz_m, icp.voxel_m * _MAP_SHARE)]
    source = map_points[first_in_voxels(map_points.xyz_m, icp.voxel_m * _SOURCE_SHARE)]
    return PreparedSweep(time_s, map_points, source, _upright(cloud, structure))


def prepare_structure(
    xyz_ego_m: Floats, offset_s: Floats, icp: KissIcpConfig, structure: StructureConfig
) -> Cloud:
    """Find the upright structure of a sweep, for poses that are measured and not estimated.

    Args:
        xyz_ego_m: (n, 3) points in ego axes.
        offset_s: (n,) when each was measured, after the frame's time; zeros where they are motion-compensated.
        icp: Range.
        structure: What counts as upright, and its range.
    """
    return _upright(_in_range(xyz_ego_m, offset_s, icp), structure)


def _in_range(xyz_ego_m: Floats, offset_s: Floats, icp: KissIcpConfig) -> Cloud:
    xyz = np.asarray(xyz_ego_m, dtype=np.float64).reshape(-1, 3)
    range_m2 = (xyz**2).sum(axis=1)
    near = np.flatnonzero((range_m2 > icp.min_range_m**2) & (range_m2 < icp.max_range_m**2))
    return Cloud(xyz, offset_s)[near]


def _upright(cloud: Cloud, structure: StructureConfig) -> Cloud:
    upright = cloud[np.flatnonzero(find_upright(cloud.xyz_m, structure))]
    return upright[first_in_voxels(upright.xyz_m, structure.voxel_m)]


def first_in_voxels(xyz_m: Floats, voxel_m: float) -> Ints:
    """Return the places of the first point of each voxel, ascending.

    Args:
        xyz_m: (n, 3) points.
        voxel_m: Edge of the voxels.
    """
    keys = row_keys(np.floor(xyz_m / voxel_m).astype(np.int64))
    return np.sort(np.unique(keys, return_index=True)[1])


def find_upright(xyz_m: Floats, config: StructureConfig) -> Bools:
    """Return (n,) which points lie on upright things: in a cell of the ground plan that holds several heights.

    The rings that a LiDAR draws on a flat road go with the car, and so say nothing of its motion.

    Args:
        xyz_m: (n, 3) points, z up.
        config: Cells and heights.
    """
    side = int(np.ceil(config.range_m / config.cell_m))
    cells = np.floor(xyz_m[:, :2] / config.cell_m).astype(np.int64) + side
    inside = ((cells >= 0) & (cells < 2 * side)).all(axis=1)
    key = cells[:, 0] * (2 * side) + cells[:, 1]
    key[~inside] = 0
    low, high = np.full(4 * side**2, np.inf), np.full(4 * side**2, -np.inf)
    z = xyz_m[:, 2]
    np.minimum.at(low, key[inside], z[inside])
    np.maximum.at(high, key[inside], z[inside])
    is_upright = high - low > config.min_height_m
    found: Bools = inside & is_upright[key] & (z > low[key] + config.ground_clearance_m)
    return found
