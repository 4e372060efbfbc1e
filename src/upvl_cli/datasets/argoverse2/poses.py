"""Poses of the car in its city, which are given at many times: those of the sensors."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.datasets.shared.arrow import read_feather, values
from upvl_cli.datasets.shared.poses import check_pose, quaternion_rotation, rigid
from upvl_cli.types import Array, Bools

QUATERNION = ("qw", "qx", "qy", "qz")
TRANSLATION = ("tx_m", "ty_m", "tz_m")
_MAX_GAP_NS = 500_000_000  # poses are 5 to 10 ms apart; across a longer gap nobody knows how the car went


class CityTrajectory(NamedTuple):
    """Poses at ascending times.

    Attributes:
        time_ns: (n,) times.
        city_from_ego: (n, 4, 4) poses.
    """

    time_ns: Array
    city_from_ego: Array


def read_trajectory(path: Path) -> CityTrajectory:
    """Return the poses of `city_SE3_egovehicle.feather`.

    Raises:
        BadInput: The file cannot be read, or a pose is none.
    """
    table = read_feather(path, ("timestamp_ns", *QUATERNION, *TRANSLATION))
    time_ns = values(table, "timestamp_ns", "int64", path)
    wxyz = np.stack([values(table, name, "float64", path) for name in QUATERNION], axis=-1)
    xyz_m = np.stack([values(table, name, "float64", path) for name in TRANSLATION], axis=-1)
    pose = check_pose(rigid(quaternion_rotation(wxyz, f"{path}: a rotation"), xyz_m), f"{path}: pose")
    time_ns, first = np.unique(time_ns, return_index=True)
    return CityTrajectory(time_ns, pose[first])


def poses_at(trajectory: CityTrajectory, time_ns: Array) -> tuple[Array, Bools]:
    """Return (n, 4, 4) poses at any times, and (n,) whether each is known.

    A pose at another time than the given ones lies between its two neighbors, on a straight line and turned evenly.
    Before the first, after the last and within a long gap none is known, and the pose is the identity.

    Args:
        trajectory: The given poses.
        time_ns: (n,) times.
    """
    time_ns = np.asarray(time_ns, dtype=np.int64)
    pose = np.tile(np.eye(4), (len(time_ns), 1, 1))
    total = len(trajectory.time_ns)
    if not total:
        return pose, np.zeros(len(time_ns), dtype=np.bool_)
    after = np.minimum(np.searchsorted(trajectory.time_ns, time_ns), total - 1)
    exact = trajectory.time_ns[after] == time_ns
    pose[exact] = trajectory.city_from_ego[after[exact]]
    before = np.maximum(after - 1, 0)
    start_ns, end_ns = trajectory.time_ns[before], trajectory.time_ns[after]
    # Distances in floats: times of a damaged file may be farther apart than int64 holds.
    gap_ns = end_ns.astype(np.float64) - start_ns.astype(np.float64)
    between = ~exact & (start_ns < time_ns) & (time_ns < end_ns) & (gap_ns <= _MAX_GAP_NS)
    if between.any():
        share = (time_ns - start_ns)[between] / gap_ns[between]
        pose[between] = _interpolate(
            trajectory.city_from_ego[before[between]], trajectory.city_from_ego[after[between]], share
        )
    return pose, exact | between


def _interpolate(first: Array, second: Array, share: Array) -> Array:
    """Return (n, 4, 4) poses between two, at a share of the way from the first."""
    start = Rotation.from_matrix(first[:, :3, :3])
    turn = (start.inv() * Rotation.from_matrix(second[:, :3, :3])).as_rotvec()
    rotation = (start * Rotation.from_rotvec(share[:, None] * turn)).as_matrix()
    position_m = first[:, :3, 3] + share[:, None] * (second[:, :3, 3] - first[:, :3, 3])
    return rigid(rotation, position_m)
