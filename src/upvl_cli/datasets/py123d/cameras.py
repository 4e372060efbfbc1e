"""Cameras of a log: pinhole as they are, other lenses by the closest fisheye polynomial; and their pictures."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from py123d.datatypes import CameraModel

from upvl_cli.datasets.py123d.library import ArrowLog, library_errors, pose_matrices
from upvl_cli.datasets.shared.pictures import check_picture_size, read_picture
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Image

_MAX_SIZE_PX = 65535
_MAX_FOCAL_PX = 1e6
_MAX_COEFFICIENT = 1e4
_MAX_FIT_PX = 1.0  # a pixel off is as good as the calibration of such lenses
_ANGLES = 400
# The library seeks and reads a video in two steps, with one reader for all threads.
_VIDEO = threading.Lock()


def read_camera(metadata: Any, key: str, where: str) -> Camera | None:
    """Return a camera; None where it has no calibration, or a lens that no model of ours comes close to.

    Args:
        metadata: The library's description.
        key: Its modality, `camera.<name>`.
        where: The file, for the message.

    Raises:
        BadInput: A number of the calibration is impossible.
    """
    with library_errors(where):
        width_px, height_px = int(metadata.width), int(metadata.height)
        model = metadata.camera_model
        mount = np.array(metadata.camera_to_imu_se3.array, dtype=np.float64)
    if not (1 <= width_px <= _MAX_SIZE_PX and 1 <= height_px <= _MAX_SIZE_PX):
        raise BadInput(
            f"{where} has pictures of {width_px} x {height_px} pixels, which is no size of a picture"
        )
    ego_from_camera = pose_matrices(mount, f"{where}: camera_to_imu_se3", max_m=MAX_ON_CAR_M)
    name = key.partition(".")[2]
    if model == CameraModel.PINHOLE:
        with library_errors(where):
            given = None if metadata.intrinsics is None else np.array(metadata.intrinsics.camera_matrix)
            lens = metadata.distortion
            bent = np.zeros(5) if lens is None or metadata.is_undistorted else np.array(lens.array)
        if given is None:
            return None
        _check_lens(given, bent, where)
        return Camera(name, width_px, height_px, given, bent, ego_from_camera)
    with library_errors(where):
        radial = _radial(metadata, model)
    if radial is None:
        return None
    fitted = _fit_fisheye(*radial, (width_px, height_px), where)
    if fitted is None:
        return None
    return Camera(name, width_px, height_px, *fitted, ego_from_camera, "fisheye")


def _check_lens(intrinsic: Array, distortion: Array, where: str) -> None:
    focal_px = np.diag(intrinsic)[:2]
    if not (focal_px >= 1).all() or not np.abs(intrinsic).max() <= _MAX_FOCAL_PX:
        raise BadInput(
            f"{where} has the intrinsic matrix {intrinsic.tolist()}, expected a focal length of 1 to "
            f"{_MAX_FOCAL_PX:g} pixels"
        )
    if not np.abs(distortion).max(initial=0.0) <= _MAX_COEFFICIENT:
        raise BadInput(f"{where}: distortion is {distortion.tolist()}, expected finite coefficients")


def _radial(metadata: Any, model: CameraModel) -> tuple[Array, Array, Array, Array] | None:
    """Return angles off the axis (rad), the radius of each, and focal length and centre (px) of a round lens."""
    angle_rad = np.linspace(0, np.pi / 2, _ANGLES)
    if model == CameraModel.FTHETA and metadata.intrinsics is not None:
        lens = metadata.intrinsics
        radius = np.polynomial.polynomial.polyval(angle_rad, np.array(lens.fw_poly))
        return angle_rad, radius, np.ones(2), np.array([lens.cx, lens.cy])
    if model == CameraModel.FISHEYE_MEI and metadata.projection is not None:
        if metadata.mirror_parameter is None:
            return None
        lens, bent = metadata.projection, metadata.distortion
        plane = np.sin(angle_rad) / (np.cos(angle_rad) + float(metadata.mirror_parameter))
        k1, k2 = (0.0, 0.0) if bent is None else (float(bent.k1), float(bent.k2))
        radius = plane * (1 + k1 * plane**2 + k2 * plane**4)
        return angle_rad, radius, np.array([lens.gamma1, lens.gamma2]), np.array([lens.u0, lens.v0])
    return None


def _fit_fisheye(
    angle_rad: Array, radius: Array, focal_px: Array, center_px: Array, size_px: tuple[int, int], where: str
) -> tuple[Array, Array] | None:
    """Return intrinsic matrix and k1 to k4 of the fisheye closest to a round lens within its picture.

    None where it is more than a pixel off.
    """
    if not np.isfinite(np.concatenate([focal_px, center_px])).all() or not np.isfinite(radius).all():
        raise BadInput(f"{where} has a calibration that is not finite; convert the log again")
    corners = np.array([[x, y] for x in (0, size_px[0]) for y in (0, size_px[1])])
    corner_px = np.linalg.norm(corners - center_px, axis=1).max()
    beyond = np.flatnonzero(radius * np.abs(focal_px).max() > corner_px)
    count = int(beyond[0]) + 1 if len(beyond) else len(radius)
    if count < _ANGLES // 20 or not (focal_px > 0).all() or (np.diff(radius[:count]) <= 0).any():
        return None
    powers = angle_rad[:count, None] ** np.array([1, 3, 5, 7, 9])
    solution = np.linalg.lstsq(powers, radius[:count], rcond=None)[0]
    off_px = np.abs(powers @ solution - radius[:count]).max() * focal_px.max()
    if not off_px <= _MAX_FIT_PX or not solution[0] > 0:
        return None
    fx, fy = focal_px * solution[0]
    intrinsic = np.array([[fx, 0, center_px[0]], [0, fy, center_px[1]], [0, 0, 1]])
    distortion = solution[1:] / solution[0]
    _check_lens(intrinsic, distortion, where)
    return intrinsic, distortion


def check_first_picture(log: ArrowLog, iteration: int, camera: Camera) -> None:
    """Raise `BadInput` where a stored picture is of another size than its calibration says; reads its header."""
    content = log.column(iteration, f"camera.{camera.name}", "data")
    if isinstance(content, bytes):
        check_picture_size(content, camera.width_px, camera.height_px, _place(log, iteration, camera))


def read_image(log: ArrowLog, iteration: int, camera: Camera) -> Image | None:
    """Return the picture of a camera at an iteration, or None where it has none.

    Raises:
        BadInput: It is damaged, or of another size than the calibration says.
    """
    key, where = f"camera.{camera.name}", _place(log, iteration, camera)
    time_us = log.times_us(key)[iteration]
    content = None if time_us is None else log.column(iteration, key, "data")
    if time_us is None or content is None:
        return None
    # Not by the library here: OpenCV, which it uses, writes on stderr of its own about a damaged picture.
    if isinstance(content, bytes):
        rgb = read_picture(content, camera.width_px, camera.height_px, where)
    else:
        with _VIDEO:
            rgb = _rgb(log.column(iteration, key, "data", decode=True))
    if rgb.shape != (camera.height_px, camera.width_px, 3) or rgb.dtype != np.uint8:
        raise BadInput(
            f"{where} is a picture of shape {rgb.shape}, but its calibration says {camera.width_px} x "
            f"{camera.height_px} pixels; convert the log again"
        )
    return Image(rgb, time_us * 1000)


def _rgb(picture: Any) -> Array:
    found = np.asarray(picture)
    return np.repeat(found[:, :, None], 3, axis=2) if found.ndim == 2 else found


def _place(log: ArrowLog, iteration: int, camera: Camera) -> str:
    return f"{log.path(f'camera.{camera.name}')}, iteration {iteration}"
