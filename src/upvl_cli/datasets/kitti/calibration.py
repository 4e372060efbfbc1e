"""KITTI's `calib_*.txt`: where the cameras and the inertial unit sit, and how the cameras see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti.text import numbers, read_text
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

_NUMBERS = ("00", "01", "02", "03")
# The files round their rotations at 1e-6 or finer; a thousandth is a wrong file, not rounding.
_ROTATION_TOLERANCE = 1e-3
_MOST_M = 100.0  # all sensors are on one car
_MOST_WIDTH_PX = 65535
_FOCAL_PX = (1.0, 1e6)


@dataclass(frozen=True)
class Calibration:
    """What the calibration files of one recording day give.

    Attributes:
        rect_from_ego: (4, 4) from LiDAR axes to those of the rectified reference camera, in which
            KITTI's object labels are; None without `calib_velo_to_cam` and `calib_cam_to_cam`.
        ego_from_imu: (4, 4) pose of the inertial unit in LiDAR axes; None without `calib_imu_to_velo`.
        cameras: The rectified cameras by the name of their folder, for example `image_02`.
        files: The files that were read.
    """

    rect_from_ego: Array | None
    ego_from_imu: Array | None
    cameras: Mapping[str, Camera]
    files: tuple[Path, ...]


class _Fields:
    """The `key: values` lines of one calibration file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines: dict[str, tuple[str, str]] = {}
        for number, line in enumerate(read_text(path).splitlines(), start=1):
            where = f"{path}, line {number}"
            key, colon, text = line.partition(":")
            if colon:
                self._lines[key.strip()] = (where, text)
            elif line.strip():
                raise BadInput(f"{where} holds {line[:80]!r}; expected 'name: numbers': copy the file again")

    def __contains__(self, key: str) -> bool:
        return key in self._lines

    def where(self, key: str) -> str:
        return self._lines[key][0]

    def numbers(self, key: str, count: int) -> Array:
        if key not in self._lines:
            raise BadInput(f"{self.path} has no line {key!r}; copy the file from the data set again")
        where, text = self._lines[key]
        return numbers(text, count, where)

    def rotation(self, key: str) -> Array:
        matrix = self.numbers(key, 9).reshape(3, 3)
        # Clipped, so that no number is too large to multiply; what was clipped is no rotation.
        within = np.clip(matrix, -10, 10)
        skew = np.abs(within @ within.T - np.eye(3)).max()
        if not skew < _ROTATION_TOLERANCE or not np.linalg.det(matrix) > 0:
            raise BadInput(
                f"{self.where(key)}: {key} is not a rotation (off by {skew:.2g}); copy the file again"
            )
        return matrix

    def pose(self) -> Array:
        translation_m = self.numbers("T", 3)
        self.check_on_car("T", translation_m)
        return _rigid(self.rotation("R"), translation_m)

    def check_on_car(self, key: str, translation_m: Array) -> None:
        if not np.abs(translation_m).max() <= _MOST_M:
            raise BadInput(
                f"{self.where(key)}: {key} moves by {np.abs(translation_m).max():.3g} m, expected at most "
                f"{_MOST_M:g} m on one car; copy the file again"
            )


def read_calibration(folder: Path) -> Calibration:
    """Return what the `calib_*.txt` of a folder give; a missing file leaves its part out.

    Args:
        folder: The folder of the recording day.

    Returns:
        The calibration; raises `BadInput` for a line that is not what it has to be.
    """
    paths = [folder / f"calib_{name}.txt" for name in ("velo_to_cam", "cam_to_cam", "imu_to_velo")]
    velo_to_cam, cam_to_cam, imu_to_velo = (_Fields(path) if path.is_file() else None for path in paths)
    files = tuple(path for path in paths if path.is_file())
    ego_from_imu = imu_to_velo.pose() if imu_to_velo else None
    if velo_to_cam is None or cam_to_cam is None:
        return Calibration(None, ego_from_imu, {}, files)
    rect_from_ego = _rigid(cam_to_cam.rotation("R_rect_00"), np.zeros(3)) @ velo_to_cam.pose()
    cameras = {
        f"image_{number}": _camera(cam_to_cam, number, rect_from_ego)
        for number in _NUMBERS
        if f"P_rect_{number}" in cam_to_cam
    }
    return Calibration(rect_from_ego, ego_from_imu, cameras, files)


def _camera(fields: _Fields, number: str, rect_from_ego: Array) -> Camera:
    size_px = fields.numbers(f"S_rect_{number}", 2)
    projection = fields.numbers(f"P_rect_{number}", 12).reshape(3, 4)
    intrinsic = projection[:, :3]
    if not ((size_px >= 1) & (size_px <= _MOST_WIDTH_PX)).all() or not np.array_equal(
        size_px, np.round(size_px)
    ):
        raise BadInput(f"{fields.where(f'S_rect_{number}')}: {size_px} is no size of an image in pixels")
    if not _is_pinhole(intrinsic):
        raise BadInput(
            f"{fields.where(f'P_rect_{number}')}: P_rect_{number} is not [K | k] of a pinhole camera with a "
            f"focal length of {_FOCAL_PX[0]:g} to {_FOCAL_PX[1]:g} pixels; copy the file again"
        )
    # P_rect = K [I | t]: t leads from the reference camera to this one, the baseline and its small rest.
    baseline_m = np.linalg.solve(intrinsic, projection[:, 3])
    fields.check_on_car(f"P_rect_{number}", baseline_m)
    camera_from_rect = _rigid(np.eye(3), baseline_m)
    return Camera(
        name=f"image_{number}",
        width_px=int(size_px[0]),
        height_px=int(size_px[1]),
        intrinsic=intrinsic,
        distortion=np.zeros(5),  # the images are rectified
        ego_from_camera=np.linalg.inv(camera_from_rect @ rect_from_ego),
    )


def _is_pinhole(intrinsic: Array) -> bool:
    focal_px = intrinsic.diagonal()[:2]
    return bool(
        (focal_px >= _FOCAL_PX[0]).all()
        and np.abs(intrinsic).max() <= _FOCAL_PX[1]
        and intrinsic[1, 0] == 0
        and np.array_equal(intrinsic[2], (0, 0, 1))
    )


def _rigid(rotation: Array, translation_m: Array) -> Array:
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation_m
    return transform
