"""KITTI's calibration files: where the cameras and the inertial unit sit, and how the cameras see."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_rotation, rigid
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera

_NUMBERS = ("00", "01", "02", "03")
# The object, tracking and odometry sets have all in one file, and some of its keys without a colon.
_LINE = re.compile(r"([A-Za-z]\w*)(?::|[ \t])(.*)")
_VELO_TO_CAM = ("Tr_velo_to_cam", "Tr_velo_cam", "Tr")
_IMU_TO_VELO = ("Tr_imu_to_velo", "Tr_imu_velo")
_RECTIFICATION = ("R0_rect", "R_rect")
_MOST_WIDTH_PX = 65535
_FOCAL_PX = (1.0, 1e6)


@dataclass(frozen=True)
class Calibration:
    """What the calibration files of a recording give.

    Attributes:
        rect_from_ego: (4, 4) from LiDAR axes to those of the rectified reference camera, in which
            KITTI's object labels are; None where no file gives it.
        ego_from_imu: (4, 4) pose of the inertial unit in LiDAR axes; None where no file gives it.
        cameras: The rectified cameras by the name of their folder, for example `image_02`.
        files: The files that were read.
    """

    rect_from_ego: Array | None
    ego_from_imu: Array | None
    cameras: Mapping[str, Camera]
    files: tuple[Path, ...]


class CalibrationFields:
    """The `key: values` lines of one calibration file."""

    def __init__(self, path: Path, line_format: re.Pattern[str] = re.compile(r"([^:]*):(.*)")) -> None:
        self.path = path
        self._lines: dict[str, tuple[str, str]] = {}
        for number, line in enumerate(read_text(path).splitlines(), start=1):
            where = f"{path}, line {number}"
            if match := line_format.fullmatch(line):
                self._lines[match[1].strip()] = (where, match[2])
            elif line.strip():
                raise BadInput(f"{where} holds {line[:80]!r}; expected 'name: numbers': copy the file again")

    def __contains__(self, key: str) -> bool:
        return key in self._lines and bool(self._lines[key][1].strip())

    def where(self, key: str) -> str:
        """Return file and line of a key."""
        return self._lines[key][0]

    def numbers(self, key: str, count: int) -> Array:
        """Return the numbers of a key; raises `BadInput` where there are not so many."""
        if key not in self._lines:
            raise BadInput(f"{self.path} has no line {key!r}; copy the file from the data set again")
        where, text = self._lines[key]
        return numbers(text, count, where)

    def rotation(self, key: str) -> Array:
        """Return the (3, 3) rotation of a key."""
        return check_rotation(self.numbers(key, 9).reshape(3, 3), f"{self.where(key)}: {key}")

    def pose(self) -> Array:
        """Return the (4, 4) of the keys R and T."""
        translation_m = self.numbers("T", 3)
        self.check_on_car("T", translation_m)
        return rigid(self.rotation("R"), translation_m)

    def matrix(self, key: str) -> Array:
        """Return the (4, 4) of a key with 12 numbers."""
        matrix = self.numbers(key, 12).reshape(3, 4)
        rotation = check_rotation(matrix[:, :3], f"{self.where(key)}: {key}")
        self.check_on_car(key, matrix[:, 3])
        return rigid(rotation, matrix[:, 3])

    def first_of(self, keys: tuple[str, ...]) -> str | None:
        """Return the first of these keys that has numbers."""
        return next((key for key in keys if key in self), None)

    def check_on_car(self, key: str, translation_m: Array) -> None:
        """Raise `BadInput` where a sensor would not be on the car."""
        if not np.abs(translation_m).max() <= MAX_ON_CAR_M:
            raise BadInput(
                f"{self.where(key)}: {key} moves by {np.abs(translation_m).max():.3g} m, expected at most "
                f"{MAX_ON_CAR_M:g} m on one car; copy the file again"
            )


def read_calibration(folder: Path) -> Calibration:
    """Return what the `calib_*.txt` of a raw recording give; a missing file leaves its part out.

    Args:
        folder: The folder of the recording day.

    Returns:
        The calibration; raises `BadInput` for a line that is not what it has to be.
    """
    paths = [folder / f"calib_{name}.txt" for name in ("velo_to_cam", "cam_to_cam", "imu_to_velo")]
    velo_to_cam, cam_to_cam, imu_to_velo = (
        CalibrationFields(path) if path.is_file() else None for path in paths
    )
    files = tuple(path for path in paths if path.is_file())
    ego_from_imu = imu_to_velo.pose() if imu_to_velo else None
    if velo_to_cam is None or cam_to_cam is None:
        return Calibration(None, ego_from_imu, {}, files)
    rect_from_ego = rigid(cam_to_cam.rotation("R_rect_00"), np.zeros(3)) @ velo_to_cam.pose()
    cameras = {
        f"image_{number}": rectified_camera(
            cam_to_cam,
            f"P_rect_{number}",
            rect_from_ego,
            f"image_{number}",
            picture_size_px(cam_to_cam, f"S_rect_{number}"),
        )
        for number in _NUMBERS
        if f"P_rect_{number}" in cam_to_cam
    }
    return Calibration(rect_from_ego, ego_from_imu, cameras, files)


def read_benchmark_calibration(
    path: Path, names: tuple[str, ...], sizes_px: Mapping[str, tuple[int, int]]
) -> Calibration:
    """Return what the one file of the object, tracking or odometry set gives; nothing where it is missing.

    Args:
        path: The file, with `P0` to `P3` and where the LiDAR is.
        names: The names of the cameras 0 to 3.
        sizes_px: Width and height of the pictures of each camera that has some: these files do not say it.

    Raises:
        BadInput: A line is not what it has to be.
    """
    if not path.is_file():
        return Calibration(None, None, {}, ())
    fields = CalibrationFields(path, _LINE)
    imu = fields.first_of(_IMU_TO_VELO)
    ego_from_imu = fields.matrix(imu) if imu else None
    velo = fields.first_of(_VELO_TO_CAM)
    if velo is None:
        return Calibration(None, ego_from_imu, {}, (path,))
    rect_from_ego = fields.matrix(velo)
    rectification = fields.first_of(_RECTIFICATION)
    if rectification:
        rect_from_ego = rigid(fields.rotation(rectification), np.zeros(3)) @ rect_from_ego
    cameras = {
        name: rectified_camera(fields, f"P{number}", rect_from_ego, name, sizes_px.get(name))
        for number, name in enumerate(names)
        if f"P{number}" in fields
    }
    return Calibration(rect_from_ego, ego_from_imu, cameras, (path,))


def picture_size_px(fields: CalibrationFields, key: str) -> tuple[int, int]:
    """Return width and height of pictures; raises `BadInput` where they are none."""
    size_px = fields.numbers(key, 2)
    if not ((size_px >= 1) & (size_px <= _MOST_WIDTH_PX)).all() or not np.array_equal(
        size_px, np.round(size_px)
    ):
        raise BadInput(f"{fields.where(key)}: {size_px} is no size of an image in pixels")
    return int(size_px[0]), int(size_px[1])


def rectified_camera(
    fields: CalibrationFields,
    key: str,
    rect_from_ego: Array,
    name: str,
    size_px: tuple[int, int] | None,
    *,
    is_reference: bool = False,
) -> Camera:
    """Return a camera whose pictures are rectified.

    Args:
        fields: Its calibration file.
        key: The key of its projection [K | k].
        rect_from_ego: (4, 4) from LiDAR axes to those of the rectified reference camera.
        name: The name of the camera.
        size_px: Width and height of its pictures; None where nobody knows them.
        is_reference: Whether it is itself the reference camera, whatever k says.

    Raises:
        BadInput: It is no pinhole camera on the car.
    """
    projection = fields.numbers(key, 12).reshape(3, 4)
    intrinsic = projection[:, :3]
    if not _is_pinhole(intrinsic):
        raise BadInput(
            f"{fields.where(key)}: {key} is not [K | k] of a pinhole camera with a "
            f"focal length of {_FOCAL_PX[0]:g} to {_FOCAL_PX[1]:g} pixels; copy the file again"
        )
    if size_px is None:  # the centre is near the middle
        size_px = _twice(intrinsic[0, 2]), _twice(intrinsic[1, 2])
    # P = K [I | t]: t leads from the reference camera to this one, the baseline and its small rest.
    baseline_m = np.zeros(3) if is_reference else np.linalg.solve(intrinsic, projection[:, 3])
    fields.check_on_car(key, baseline_m)
    camera_from_rect = rigid(np.eye(3), baseline_m)
    return Camera(
        name=name,
        width_px=size_px[0],
        height_px=size_px[1],
        intrinsic=intrinsic,
        distortion=np.zeros(5),  # the images are rectified
        ego_from_camera=np.linalg.inv(camera_from_rect @ rect_from_ego),
    )


def _twice(centre_px: float) -> int:
    return int(np.clip(round(2 * centre_px), 1, _MOST_WIDTH_PX))


def _is_pinhole(intrinsic: Array) -> bool:
    focal_px = intrinsic.diagonal()[:2]
    return bool(
        (focal_px >= _FOCAL_PX[0]).all()
        and np.abs(intrinsic).max() <= _FOCAL_PX[1]
        and intrinsic[1, 0] == 0
        and np.array_equal(intrinsic[2], (0, 0, 1))
    )
