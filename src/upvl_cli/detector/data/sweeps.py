"""Two sweeps as one cloud of points with a time column: the current sweep, and the one before it moved by odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.detector.config import SweepsConfig
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Floats, Ints, ParallelArrays, Points, array


@dataclass(frozen=True)
class Trajectory(ParallelArrays):
    """Where and when the sweeps of a drive were taken.

    Attributes:
        frame: (T,) numbers of the frames.
        time_ns: (T,) time of each.
        world_from_ego: (T, 4, 4) pose of each.
    """

    frame: Ints = array("int64")
    time_ns: Ints = array("int64")
    world_from_ego: Floats = array("float64", 4, 4)


@dataclass(frozen=True)
class TwoSweeps:
    """The two-frame input of a drive.

    Attributes:
        trajectory: Where and when its sweeps were taken.
        read: Returns the points of the frame of that number.
        ground_z_m: Height of the road in ego axes; the detector sees heights above it, whatever the car.
        config: Age and thinning of the older sweep.
    """

    trajectory: Trajectory
    read: Callable[[int], Points]
    ground_z_m: float
    config: SweepsConfig

    def points(self, index: int) -> Array:
        """Return (n, 6) points as in `Sample`: those of a sweep, then those of the sweep before, thinned.

        Args:
            index: Which of the trajectory's frames.
        """
        here = self.trajectory
        sweeps = [_columns(self.read(int(here.frame[index])), 0.0)]
        since_s = (here.time_ns[index - 1] - here.time_ns[index]) * 1e-9 if index else -np.inf
        if since_s >= -self.config.max_age_s:
            older = _columns(self.read(int(here.frame[index - 1])), since_s)
            older = older[_first_of_voxel(older[:, :3], self.config.voxel_m)]
            now_from_older = inverse(here.world_from_ego[index]) @ here.world_from_ego[index - 1]
            older[:, :3] = apply(now_from_older, older[:, :3])
            sweeps.append(older)
        points = np.concatenate(sweeps)
        points[:, 2] -= self.ground_z_m
        return points


def _columns(points: Points, time_s: float) -> Array:
    """Return (n, 6) float32 x, y, z, intensity, elongation, time."""
    return np.column_stack(
        [
            points.xyz_ego_m,
            points.intensity,
            points.elongation,
            np.full(len(points), time_s, dtype=np.float32),
        ]
    )


def _first_of_voxel(xyz_m: Array, voxel_m: float) -> Ints:
    """Return the index of the first point of each voxel, ascending."""
    cell = np.floor(xyz_m / voxel_m).astype(np.int64) + 2**20  # 21 bits an axis: 400 km
    key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
    return np.sort(np.unique(key, return_index=True)[1])
