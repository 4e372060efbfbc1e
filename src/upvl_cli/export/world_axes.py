"""Boxes in the axes of the world: upright on the car that saw them, so tilted as it is; and their way back."""

from __future__ import annotations

import numpy as np

from upvl_cli.export.drive import ExportDrive
from upvl_cli.geometry.se3 import apply, compose, from_yaw, inverse, rotate, yaw_of
from upvl_cli.types import Array, Floats


def quaternions_wxyz(a_from_b: Array) -> Floats:
    """Return (..., 4) quaternions w, x, y, z of rigid transforms, w at least 0.

    Args:
        a_from_b: (..., 4, 4) transforms.
    """
    from scipy.spatial.transform import Rotation

    matrices = np.asarray(a_from_b, dtype=np.float64)[..., :3, :3]
    if not matrices.size:
        return np.zeros((*matrices.shape[:-2], 4))
    xyzw = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat()
    wxyz = np.roll(xyzw, 1, axis=-1)
    wxyz = np.where(wxyz[:, :1] < 0, -wxyz, wxyz) + 0.0  # no negative zero
    return np.asarray(wxyz.reshape(*matrices.shape[:-2], 4))


def boxes_in_world(drive: ExportDrive) -> tuple[Floats, Floats]:
    """Return (n, 3) centres in the axes of the world, and (n, 4) rotations as w, x, y, z."""
    boxes, poses = drive.boxes, drive.world_from_ego[drive.places]
    center_m = apply(poses, boxes.center_m[:, None])[:, 0]
    ego_from_box = from_yaw(boxes.heading_rad, np.zeros((len(boxes), 3)))
    return np.asarray(center_m), quaternions_wxyz(compose(poses, ego_from_box))


def rows_in_ego(world_from_box: Array, size_lwh_m: Array, world_from_ego: Array) -> Floats:
    """Return (n, 7) boxes in ego axes; of one that is tilted there, the heading in the ego's xy plane stays.

    Args:
        world_from_box: (n, 4, 4) poses of the boxes.
        size_lwh_m: (n, 3) sizes.
        world_from_ego: (n, 4, 4) pose of the car at the frame of each box.
    """
    ego_from_box = compose(inverse(world_from_ego), world_from_box)
    return np.column_stack([ego_from_box[:, :3, 3], size_lwh_m, yaw_of(ego_from_box)])


def velocity_in_ego(velocity_world_mps: Array, world_from_ego: Array) -> Floats:
    """Return (n, 3) velocities along the axes of the ego; NaN where one is not known."""
    return np.asarray(rotate(inverse(world_from_ego), velocity_world_mps[:, None])[:, 0])


def count_vertical(velocity_world_mps: Array) -> int:
    """Return how many boxes move up or down the world's z by more than a millimetre per second."""
    known = np.isfinite(velocity_world_mps).all(axis=1)
    return int((np.abs(velocity_world_mps[known, 2]) > 1e-3).sum())
