"""Which points of a sweep lie on the car itself."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array, Bools

# The Renault Zoe of nuScenes from the middle of its rear axle: 4.084 m long, of which 0.657 m lie behind the axle, and
# 1.730 m wide. The margin holds mirrors, and what compensation for motion does to the points of the car itself: it
# moves those at its rear backward by up to 0.3 m at 15 m/s.
_REAR_M, _FRONT_M, _SIDE_M, _MARGIN_M = -0.657, 3.427, 0.865, 0.3
_NEAR_LIDAR_M = 1.0


def is_on_zoe(xyz_ego_m: Array) -> Bools:
    """Return which of (n, 3) points in ego axes lie on the car of nuScenes."""
    x_m, y_m = xyz_ego_m[:, 0], xyz_ego_m[:, 1]
    along = (x_m > _REAR_M - _MARGIN_M) & (x_m < _FRONT_M + _MARGIN_M)
    return along & (y_m > -_SIDE_M - _MARGIN_M) & (y_m < _SIDE_M + _MARGIN_M)


def is_at_lidar(xyz_lidar_m: Array) -> Bools:
    """Return which of (n, 3) points in LiDAR axes the tools of Lyft drop: within 1 m along x and y."""
    return np.asarray((np.abs(xyz_lidar_m[:, :2]) < _NEAR_LIDAR_M).all(axis=1))
