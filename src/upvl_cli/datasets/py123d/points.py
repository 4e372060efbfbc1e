"""Sweeps: points in the axes of py123d's IMU frame, which are the ego axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from upvl_cli.datasets.py123d.library import ArrowLog, library_errors, pose_matrices
from upvl_cli.datasets.py123d.stored import check_stored_sweep
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Bools, Frame, Points

_MAX_M = 1e4  # a LiDAR sees a few hundred metres
_MAX_OFFSET_NS = 2_000_000_000  # a sweep lasts a tenth of a second
_MAX_CAR_M = 30.0


@dataclass(frozen=True)
class CarOutline:
    """The box of the recording car.

    Attributes:
        ego_from_center: (4, 4) pose of its centre.
        size_lwh_m: (3,) length, width, height.
    """

    ego_from_center: Array
    size_lwh_m: Array

    def contains(self, xyz_ego_m: Array) -> Bools:
        """Return (n,) whether each place is inside of it."""
        reach_m = np.linalg.norm(self.size_lwh_m) / 2
        near = np.flatnonzero((np.abs(xyz_ego_m - self.ego_from_center[:3, 3]) < reach_m).all(axis=1))
        xyz = apply(inverse(self.ego_from_center), xyz_ego_m[near])
        inside = np.zeros(len(xyz_ego_m), dtype=np.bool_)
        inside[near] = (np.abs(xyz) < self.size_lwh_m / 2).all(axis=1)
        return inside


def car_outline(ego: Any, where: str) -> CarOutline | None:
    """Return the outline of the car; None where its size is not that of a car.

    Args:
        ego: The library's description of the car.
        where: The file, for the message.

    Raises:
        BadInput: The pose of its centre is impossible.
    """
    with library_errors(where):
        size_lwh_m = np.array([ego.length, ego.width, ego.height], dtype=np.float64)
        center = np.array(ego.center_to_imu_se3.array, dtype=np.float64)
    if not ((size_lwh_m > 0) & (size_lwh_m <= _MAX_CAR_M)).all():
        return None
    return CarOutline(pose_matrices(center, f"{where}: center_to_imu_se3", max_m=MAX_ON_CAR_M), size_lwh_m)


def read_sweep(log: ArrowLog, key: str, frame: Frame, outline: CarOutline | None) -> Points | None:
    """Return the points of one LiDAR in a frame; None where it has no sweep there.

    Args:
        log: The log.
        key: The LiDAR's modality.
        frame: The frame.
        outline: The car, whose points are dropped.

    Raises:
        BadInput: The sweep is damaged, or its numbers are impossible.
    """
    where = f"{log.path(key)}, iteration {frame.index}"
    if log.times_us(key)[frame.index] is None:
        return None
    content = log.column(frame.index, key, "data")
    if isinstance(content, bytes):
        check_stored_sweep(content, where)
    metadata = log.metadatas[key]
    with library_errors(where):
        lidar: Any = log.scene.get_modality_at_iteration(
            frame.index, metadata.modality_type, metadata.modality_id
        )
    if lidar is None:
        raise BadInput(f"{where} has a time but no points; convert the log again")
    with library_errors(where):
        xyz, ids, intensity = lidar.xyz, lidar.ids, lidar.intensity
        elongation, time_us = lidar.elongation, lidar.timestamps
        sensor = int(metadata.modality_id)
    xyz = _checked_places(xyz, where)
    points = Points(
        xyz,
        _feature(intensity, len(xyz), where).astype(np.float32) / 255,
        _elongation(elongation, len(xyz), where),
        np.full(len(xyz), sensor) if ids is None else _feature(ids, len(xyz), where),
        _offsets_ns(_feature(time_us, len(xyz), where), frame) if time_us is not None else np.zeros(len(xyz)),
    )
    keep = np.isfinite(xyz).all(axis=1)
    if outline is not None:
        keep &= ~outline.contains(xyz)
    return points if keep.all() else points[keep]


def _checked_places(xyz: Any, where: str) -> Array:
    found = np.asarray(xyz)
    if found.ndim != 2 or found.shape[1] != 3 or found.dtype.kind not in "fiu":
        raise BadInput(
            f"{where} has points of shape {found.shape}, type {found.dtype}; expected x, y, z each"
        )
    with np.errstate(all="ignore"):
        xyz_m = found.astype(np.float32)
    xyz_m = np.where(np.isinf(xyz_m), np.float32(np.nan), xyz_m)
    far_m = float(np.nanmax(np.abs(xyz_m), initial=0.0))
    if far_m >= _MAX_M:
        raise BadInput(f"{where} has a point {far_m:.3g} m away, expected metres; check the unit")
    return np.asarray(xyz_m)


def _feature(values: Any, count: int, where: str) -> Array:
    if values is None:
        return np.zeros(count)
    found = np.asarray(values)
    if found.shape != (count,):
        raise BadInput(
            f"{where} has {found.shape} values of a feature for {count} points; convert the log again"
        )
    return found


def _elongation(values: Any, count: int, where: str) -> Array:
    width = _feature(values, count, where).astype(np.float32)
    return width if values is None else np.nan_to_num(width, posinf=0, neginf=0)


def _offsets_ns(time_us: Array, frame: Frame) -> Array:
    """Return (n,) times after the frame's; 0 for all where the library's times are from another origin."""
    time_us = time_us.astype(np.int64)
    start_us = frame.time_ns // 1000
    if len(time_us) and max(
        abs(int(time_us.min()) - start_us), abs(int(time_us.max()) - start_us)
    ) * 1000 >= (_MAX_OFFSET_NS):
        return np.zeros(len(time_us), dtype=np.int64)
    return (time_us - start_us) * 1000
