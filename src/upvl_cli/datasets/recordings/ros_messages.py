"""What single messages of ROS say, in the types of a drive. Messages come from files: every number is checked."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from PIL import Image

from upvl_cli.datasets.recordings.camera_file import make_camera
from upvl_cli.datasets.shared.point_files.scan import ScanPoints, scan_points
from upvl_cli.datasets.shared.poses import check_pose, quaternion_rotation, rigid
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_CHANNELS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
             "mono8": (1, (0, 0, 0)), "8UC1": (1, (0, 0, 0)), "8UC3": (3, (2, 1, 0))}  # fmt: skip
_BROWN, _FISHEYE = ("plumb_bob", "rational_polynomial", "", "none", "brown"), ("equidistant", "fisheye")
_MOST_PX = 65535
_JPEG_QUALITY = 95


def stamp_ns(message: Any, log_ns: int) -> int:
    """Return the time in a message's header; the log time where the sensor's driver left it empty."""
    time_ns = int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)
    return time_ns or log_ns


def cloud(message: Any, where: str) -> ScanPoints:
    """Return the points of a `PointCloud2` of any layout.

    Raises:
        BadInput: Its fields and its data do not fit each other, or x, y or z is missing.
    """
    order, step = ">" if message.is_bigendian else "<", int(message.point_step)
    width, height, row_step = int(message.width), int(message.height), int(message.row_step)
    data = np.ascontiguousarray(message.data, dtype=np.uint8)
    names, formats, offsets = [], [], []
    for known in message.fields:
        kind = _FIELD_TYPES.get(int(known.datatype))
        end = int(known.offset) + (np.dtype(kind).itemsize if kind else 0) * max(int(known.count), 1)
        if kind is None or end > step:
            raise BadInput(
                f"{where}: field {known.name[:40]!r} is of type {known.datatype} and ends at {end} of {step} bytes"
            )
        if known.name and known.name not in names:
            names.append(known.name)
            formats.append(order + kind)
            offsets.append(int(known.offset))
    row_step = row_step if height > 1 else width * step
    if not step or row_step < width * step or row_step * height > len(data):
        raise BadInput(
            f"{where}: {width} x {height} points of {step} bytes do not fit its {len(data)} bytes of data"
        )
    rows = data[: row_step * height].reshape(height, row_step)[:, : width * step]
    point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    points = np.ascontiguousarray(rows).reshape(-1).view(point)
    return scan_points(
        {name: points[name] for name in names}, f"PointCloud2 with {', '.join(names)}"[:200], where
    )


def pose(message: Any, where: str) -> Array:
    """Return the (4, 4) pose of an Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped.

    Raises:
        BadInput: It is no pose.
    """
    if hasattr(message, "transform"):
        place, turn = message.transform.translation, message.transform.rotation
    else:
        inner = getattr(message.pose, "pose", message.pose)
        place, turn = inner.position, inner.orientation
    rotation = quaternion_rotation(np.array([turn.w, turn.x, turn.y, turn.z]), where)
    return check_pose(rigid(rotation, np.array([place.x, place.y, place.z])), where)


def camera(message: Any, name: str, ego_from_camera: Array, *, is_rectified: bool) -> Camera:
    """Return the camera of a `CameraInfo`.

    Args:
        message: The message, of ROS 1 or 2.
        name: Name of the camera.
        ego_from_camera: (4, 4) pose of its optical frame.
        is_rectified: Whether its pictures are rectified: then P counts and there is no distortion.

    Raises:
        BadInput: It is not calibrated, or its distortion is of a model that cannot be expressed.
    """
    where = f"CameraInfo of camera {name}"
    intrinsic = np.array(_field(message, "k"), dtype=np.float64).reshape(3, 3)
    distortion = np.array(_field(message, "d"), dtype=np.float64)
    if is_rectified:
        intrinsic, distortion = (
            np.array(_field(message, "p"), dtype=np.float64).reshape(3, 4)[:, :3],
            np.zeros(0),
        )
    size_px = (int(message.width), int(message.height))
    is_pinhole = np.isfinite(intrinsic).all() and intrinsic[0, 0] > 0 and intrinsic[1, 1] > 0
    if not is_pinhole or not all(1 <= length <= _MOST_PX for length in size_px):
        raise BadInput(
            f"{where} is not calibrated: {size_px[0]} x {size_px[1]} pixels, K {intrinsic.ravel().tolist()}"
        )
    model = str(message.distortion_model)
    if not np.isfinite(distortion).all() or not distortion.any():
        distortion = np.zeros(0)
    is_fisheye = model in _FISHEYE and not is_rectified
    if (
        model not in (*_BROWN, *_FISHEYE)
        or (not is_fisheye and distortion[5:].any())
        or (is_fisheye and len(distortion) not in (0, 4))
    ):
        raise BadInput(
            f"{where} has distortion {model[:40]!r} with {len(distortion)} numbers; expected plumb_bob (5) or "
            "equidistant (4): give its rectified pictures and rectified = true"
        )
    if len(distortion):
        distortion = distortion[:4] if is_fisheye else np.pad(distortion, (0, 5))[:5]
    return make_camera(name, size_px, intrinsic, distortion.tolist(), ego_from_camera, is_fisheye=is_fisheye)


def _field(message: Any, name: str) -> Any:
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())


def picture(message: Any, where: str) -> bytes:
    """Return the JPEG or PNG of a `CompressedImage`, or of an `Image`, which is compressed to JPEG.

    Raises:
        BadInput: It is in another format.
    """
    if not hasattr(message, "encoding"):
        content = np.asarray(message.data, dtype=np.uint8).tobytes()
        if content[:3] == b"\xff\xd8\xff" or content[:4] == b"\x89PNG":
            return content
        raise BadInput(f"{where}: a picture of format {str(message.format)[:40]!r} is neither JPEG nor PNG")
    channels, order = _CHANNELS.get(str(message.encoding), (0, (0, 0, 0)))
    width, height, step = int(message.width), int(message.height), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if (
        not channels
        or not 0 < width <= _MOST_PX
        or step < width * channels
        or step * height > len(data)
        or not height
    ):
        raise BadInput(
            f"{where}: a picture of encoding {str(message.encoding)[:40]!r}, {width} x {height}; expected one of "
            f"{', '.join(_CHANNELS)} with data of that size"
        )
    rows = data[: step * height].reshape(height, step)[:, : width * channels].reshape(height, width, channels)
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(rows[:, :, list(order)])).save(file, "JPEG", quality=_JPEG_QUALITY)
    return file.getvalue()


def optical(ego_from_camera: Array) -> tuple[Array, bool]:
    """Return the pose of the optical frame, and whether it had to be turned.

    A frame whose z axis points up is that of the camera's body (x forward, REP 103) and not its optical frame.

    Args:
        ego_from_camera: (4, 4) pose of the frame that the pictures name.
    """
    if ego_from_camera[2, 2] < 0.5:
        return ego_from_camera, False
    body_from_optical = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
    return np.asarray(ego_from_camera @ body_from_optical), True
