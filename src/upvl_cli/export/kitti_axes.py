"""The axes of KITTI's labels: a camera looking forward, boxes that stand on their bottom, and how upvl's map to them.

KITTI (Geiger et al., CVPR 2012; devkit, readme of the object benchmark): x right, y down, z forward; the location of a
box is the centre of its bottom; rotation_y turns about y, 0 along x, so -pi/2 drives away from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.export.drive import ExportDrive, Losses
from upvl_cli.geometry.box_projection import projected_boxes
from upvl_cli.geometry.boxes import corners
from upvl_cli.geometry.se3 import apply, inverse, wrap_angle
from upvl_cli.types import Array, Boxes, Camera, Floats

# Of a drive without a camera: at the ego origin, looking forward.
_FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
_NO_PICTURE = (-1.0, -1.0, -1.0, -1.0)


@dataclass(frozen=True)
class KittiColumns:
    """Boxes as KITTI's columns have them.

    Attributes:
        truncated: (n,) share of the box outside the picture, 0 to 1.
        alpha_rad: (n,) heading as the camera sees it.
        xyxy_px: (n, 4) rectangle in the picture; -1 where the picture does not show it.
        size_hwl_m: (n, 3) height, width, length.
        bottom_m: (n, 3) centre of the bottom, in camera axes.
        rotation_y_rad: (n,) heading about the camera's y.
    """

    truncated: Floats
    alpha_rad: Floats
    xyxy_px: Floats
    size_hwl_m: Floats
    bottom_m: Floats
    rotation_y_rad: Floats


def forward_camera(drive: ExportDrive, name: str) -> Camera | None:
    """Return the camera of a name, or the one that looks most nearly forward; None where the drive has none.

    Raises:
        BadSetting: The drive has cameras, but none of that name.
    """
    if not drive.cameras:
        return None
    if not name:
        return max(drive.cameras, key=lambda camera: float(camera.ego_from_camera[0, 2]))
    for camera in drive.cameras:
        if camera.name == name:
            return camera
    known = ", ".join(camera.name for camera in drive.cameras)
    raise BadSetting(f"drive {drive.name} has no camera {name!r} (its cameras: {known})")


def camera_from_ego(camera: Camera | None) -> Array:
    """Return (4, 4) the transform into the axes of KITTI's labels."""
    return inverse(_FORWARD if camera is None else camera.ego_from_camera)


def kitti_labels(boxes: Boxes, camera: Camera | None, losses: Losses) -> KittiColumns:
    """Return boxes in ego axes as KITTI's columns."""
    transform = camera_from_ego(camera)
    down = boxes.size_lwh_m[:, 2:] * np.array([0.0, 0.0, -0.5])
    bottom = apply(transform, boxes.center_m + down)
    rotation = _rotation_y(transform[:3, :3], boxes.heading_rad)
    rectangle, truncated = _rectangles(boxes, camera)
    losses["boxes that the picture does not show: written without a rectangle"] += int(
        (rectangle[:, 0] < 0).sum()
    )
    return KittiColumns(
        truncated=truncated,
        alpha_rad=wrap_angle(rotation - np.arctan2(bottom[:, 0], bottom[:, 2])),
        xyxy_px=rectangle,
        size_hwl_m=boxes.size_lwh_m[:, ::-1],
        bottom_m=bottom,
        rotation_y_rad=rotation,
    )


def boxes_of_labels(columns: Array, transform: Array) -> Floats:
    """Return (n, 7) boxes in ego axes from KITTI's columns.

    Args:
        columns: (n, 7) height, width, length, x, y, z (bottom, camera axes), rotation_y.
        transform: (4, 4) camera from ego.
    """
    columns = np.asarray(columns, dtype=np.float64).reshape(-1, 7)
    size_lwh = columns[:, 2::-1]
    bottom = apply(inverse(transform), columns[:, 3:6])
    center = bottom + size_lwh[:, 2:] * np.array([0.0, 0.0, 0.5])
    return np.column_stack([center, size_lwh, _heading(transform[:3, :3], columns[:, 6])])


def _rotation_y(rotation: Array, heading_rad: Array) -> Floats:
    """Return (n,) the angle about y of each heading, as its shadow in the camera's xz plane shows it."""
    direction = rotation[:, :2] @ np.array([np.cos(heading_rad), np.sin(heading_rad)])
    return np.asarray(np.arctan2(-direction[2], direction[0]))


def _heading(rotation: Array, rotation_y: Array) -> Floats:
    """Return (n,) the heading in the ego's xy plane whose shadow has that angle: the inverse of `_rotation_y`.

    The shadow of (cos h, sin h) is linear in it, so the direction solves a 2 x 2 system.
    """
    shadow = np.array([np.cos(rotation_y), -np.sin(rotation_y)])  # along x and z
    direction = np.linalg.solve(rotation[[0, 2], :2], shadow)
    return np.asarray(np.arctan2(direction[1], direction[0]))


def _rectangles(boxes: Boxes, camera: Camera | None) -> tuple[Floats, Floats]:
    """Return (n, 4) rectangles cut to the picture, and (n,) the share of each that lies outside."""
    if camera is None or not len(boxes):
        return np.tile(_NO_PICTURE, (len(boxes), 1)), np.ones(len(boxes))
    edges_px, inside = projected_boxes(camera, corners(boxes))
    seen = np.asarray(np.isfinite(edges_px).all(axis=1))
    border = np.array([camera.width_px, camera.height_px, camera.width_px, camera.height_px]) - 1.0
    cut = np.clip(np.where(seen[:, None], edges_px, 0.0), 0.0, border)
    return np.where(seen[:, None], cut, np.array(_NO_PICTURE)), 1.0 - inside
