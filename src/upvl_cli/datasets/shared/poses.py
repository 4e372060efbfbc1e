"""Rigid transforms as data give them: matrices and quaternions."""

from __future__ import annotations

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Array

# Files round rotations at 1e-6 or finer; a thousandth is a wrong file, not rounding.
ROTATION_TOLERANCE = 1e-3
_MAX_ENTRY = 10.0  # of a rotation; cut off here, no product of a damaged one overflows
MAX_POSITION_M = 1e8  # more than around the Earth, as geocentric and UTM coordinates need
MAX_ON_CAR_M = 100.0  # all sensors are on one car


def check_rotation(rotation: Array, where: str) -> Array:
    """Return (..., 3, 3) rotations, float64.

    Args:
        rotation: (..., 3, 3) matrices.
        where: What they are, file and row, for the message.

    Raises:
        BadInput: One is no rotation within 0.001.
    """
    rotation = np.asarray(rotation, dtype=np.float64)
    # Not a number is as far from a rotation as what is cut off.
    within = np.clip(np.nan_to_num(rotation, nan=_MAX_ENTRY), -_MAX_ENTRY, _MAX_ENTRY)
    skew = np.abs(within @ np.swapaxes(within, -1, -2) - np.eye(3)).max(axis=(-2, -1), initial=0.0)
    wrong = ~((skew < ROTATION_TOLERANCE) & (np.linalg.det(within) > 0))
    if wrong.any():
        row = f" number {int(np.flatnonzero(wrong)[0])}" if np.ndim(wrong) else ""
        off = float(np.atleast_1d(skew)[np.flatnonzero(np.atleast_1d(wrong))[0]])
        raise BadInput(f"{where}{row} is not a rotation (off by {off:.2g}); copy the file again")
    return rotation


def check_pose(matrix: Array, where: str, *, max_m: float = MAX_POSITION_M) -> Array:
    """Return (..., 4, 4) rigid transforms, float64.

    Args:
        matrix: (..., 4, 4) matrices, or (..., 3, 4) without the last row.
        where: What they are, file and row, for the message.
        max_m: Largest coordinate of a translation; `MAX_ON_CAR_M` for what is mounted on one car.

    Raises:
        BadInput: One is not finite, no rigid transform, or too far away.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    pose = np.broadcast_to(np.eye(4), (*matrix.shape[:-2], 4, 4)).copy()
    pose[..., : matrix.shape[-2], :] = matrix
    check_rotation(pose[..., :3, :3], where)
    if not np.abs(pose[..., 3, :] - [0, 0, 0, 1]).max(initial=0.0) < ROTATION_TOLERANCE:
        raise BadInput(f"{where} is no rigid transform: its last row must be 0 0 0 1; copy the file again")
    pose[..., 3, :] = [0, 0, 0, 1]
    far_m = float(np.abs(pose[..., :3, 3]).max(initial=0.0))
    if not far_m <= max_m:
        raise BadInput(f"{where} moves by {far_m:.3g} m, expected at most {max_m:g} m; copy the file again")
    return pose


def quaternion_rotation(quaternion_wxyz: Array, where: str) -> Array:
    """Return the (..., 3, 3) rotations of quaternions.

    Args:
        quaternion_wxyz: (..., 4) w, x, y, z; of length 1 within 0.001.
        where: What they are, file and row, for the message.

    Raises:
        BadInput: One has another length.
    """
    wxyz = np.asarray(quaternion_wxyz, dtype=np.float64)
    length = np.linalg.norm(np.clip(wxyz, -_MAX_ENTRY, _MAX_ENTRY), axis=-1, keepdims=True)
    if not np.abs(length - 1).max(initial=0.0) < ROTATION_TOLERANCE:
        worst = float(length.ravel()[np.nanargmax(np.nan_to_num(np.abs(length - 1).ravel(), nan=np.inf))])
        raise BadInput(f"{where} is a quaternion of length {worst:.4g}, expected 1; copy the file again")
    w, x, y, z = np.moveaxis(wxyz / length, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rigid(rotation: Array, translation_m: Array) -> Array:
    """Return (..., 4, 4) transforms of (..., 3, 3) rotations and (..., 3) translations."""
    translation_m = np.asarray(translation_m, dtype=np.float64)
    pose = np.zeros((*translation_m.shape[:-1], 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = translation_m
    pose[..., 3, 3] = 1.0
    return pose
