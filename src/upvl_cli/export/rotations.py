"""Turns as other formats have them: quaternions in the order x, y, z, w, and the heading of a nose."""

from __future__ import annotations

import numpy as np

from upvl_cli.datasets.shared.poses import quaternion_rotation
from upvl_cli.types import Array, Floats


def quat_xyzw_of_heading(heading_rad: Array | float) -> Floats:
    """Return (..., 4) the quaternions of turns about z."""
    half = np.asarray(heading_rad, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def quat_xyzw_of_matrix(rotation: Array) -> Floats:
    """Return (4,) the quaternion of a (3, 3) rotation, with w of at least 0."""
    from scipy.spatial.transform import Rotation

    quat_xyzw: Floats = Rotation.from_matrix(np.asarray(rotation, dtype=np.float64)).as_quat()
    return np.asarray(-quat_xyzw if quat_xyzw[3] < 0 else quat_xyzw)


def matrix_of_quat_xyzw(quat_xyzw: Array | list[float], where: str) -> Floats:
    """Return the (3, 3) rotation of a quaternion; raises `BadInput` where its length is not 1."""
    x, y, z, w = (float(value) for value in quat_xyzw)
    return np.asarray(quaternion_rotation(np.array([w, x, y, z]), where))


def heading_of_nose(nose: Array) -> float:
    """Return the heading of a direction, as its shadow on the xy plane has it."""
    return float(np.arctan2(nose[1], nose[0]))


def heading_of_shadow(world_from_ego: Array, yaw_world_rad: float) -> float:
    """Return the heading in the ego's xy plane whose shadow on the world's has that angle.

    The shadow is linear in (cos h, sin h), so the direction solves a 2 x 2 system.
    """
    shadow = np.array([np.cos(yaw_world_rad), np.sin(yaw_world_rad)])
    return heading_of_nose(np.linalg.solve(np.asarray(world_from_ego)[:2, :2], shadow))
