"""Where sensors are mounted, and how cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from upvl_cli.datasets.nuscenes.records import Channel
from upvl_cli.datasets.nuscenes.tables import Row, numbers_of, row_name
from upvl_cli.datasets.shared.pictures import check_picture_size, picture_size
from upvl_cli.datasets.shared.poses import (
    MAX_ON_CAR_M,
    MAX_POSITION_M,
    check_pose,
    quaternion_rotation,
    rigid,
)
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

_MAX_PX = 1e5


def pose_of(row: Row, path: Path, *, max_m: float = MAX_POSITION_M) -> Array:
    """Return the (4, 4) transform of a row with `translation` and `rotation` (a quaternion w, x, y, z)."""
    where = f"{path}: row {row_name(row)}"
    rotation = quaternion_rotation(numbers_of(row, "rotation", 4, path), where)
    return check_pose(rigid(rotation, numbers_of(row, "translation", 3, path)), where, max_m=max_m)


def poses_of(rows: Sequence[Row], path: Path) -> Array:
    """Return the (n, 4, 4) transforms of many rows at once; see `pose_of`."""
    if not rows:
        return np.zeros((0, 4, 4))
    wxyz = np.stack([numbers_of(row, "rotation", 4, path) for row in rows])
    xyz_m = np.stack([numbers_of(row, "translation", 3, path) for row in rows])
    try:
        return check_pose(rigid(quaternion_rotation(wxyz, str(path)), xyz_m), str(path))
    except BadInput:
        return np.stack([pose_of(row, path) for row in rows])  # which names the row


def ego_from_sensor(channel: Channel, path: Path) -> Array:
    """Return the (4, 4) mount of a sensor on the car."""
    return pose_of(channel.mount, path, max_m=MAX_ON_CAR_M)


def camera_of(channel: Channel, path: Path) -> Camera:
    """Return a camera with its picture size, which is that of its first picture.

    Args:
        channel: The camera, with a picture at least.
        path: The table `calibrated_sensor.json`, for messages.

    Raises:
        BadInput: The calibration is not what it has to be, or the picture has another size than its table says.
    """
    first = channel.records[0]
    width, height = first.size_px
    if width > 0 and height > 0:
        check_picture_size(first.path, width, height, first.path)
    else:
        width, height = picture_size(first.path, first.path)
    return Camera(
        name=channel.name,
        width_px=width,
        height_px=height,
        intrinsic=_intrinsic(channel.mount, path),
        distortion=_distortion(channel.mount, path),
        ego_from_camera=ego_from_sensor(channel, path),
    )


def _intrinsic(mount: Row, path: Path) -> Array:
    rows = mount.get("camera_intrinsic")
    lines = rows if isinstance(rows, list) and len(rows) == 3 else [None] * 3
    matrix = np.stack(
        [numbers_of({**mount, "camera_intrinsic": line}, "camera_intrinsic", 3, path) for line in lines]
    )
    if not (np.abs(matrix) <= _MAX_PX).all() or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise BadInput(
            f"{path}: camera_intrinsic of row {row_name(mount)} has no focal length above 0; mend it"
        )
    if matrix[2].tolist() != [0, 0, 1] or matrix[1, 0] != 0:
        raise BadInput(f"{path}: camera_intrinsic of row {row_name(mount)} is no pinhole matrix; mend it")
    return matrix


def _distortion(mount: Row, path: Path) -> Array:
    """Return k1, k2, p1, p2, k3; nuScenes and Lyft publish pictures without distortion and give none."""
    if not mount.get("camera_distortion"):
        return np.zeros(5)
    return numbers_of(mount, "camera_distortion", 5, path)
