"""A drive with the corrections that a user wrote in `raw.toml`, over any data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path

import numpy as np

from upvl_cli.config.corrections import CorrectionsConfig
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.motion_compensation import compensate
from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.ground.source import GroundSource, IncompleteSweeps
from upvl_cli.perception.odometry.source import UncompensatedSweeps
from upvl_cli.perception.visual.pixel_source import PixelSource
from upvl_cli.types import Array, Bools, Camera, Drive, Floats, Frame, Image, Points

_LETTERS = "xyz"
_BOX_SIDES, _HEIGHTS = 4, 1  # numbers of `car_m`, and of `ground_z_m` where it is not empty


def correct(drive: Drive, config: CorrectionsConfig) -> Drive:
    """Return the drive as the user says that it is: itself where nothing is corrected.

    Raises:
        BadSetting: A correction contradicts itself.
    """
    axes, pose_axes = signed_axes(config.axes, "axes"), signed_axes(config.pose_axes, "pose_axes")
    for name, value, count in (
        ("car_m", config.car_m, _BOX_SIDES),
        ("ground_z_m", config.ground_z_m, _HEIGHTS),
    ):
        if value and len(value) != count:
            raise BadSetting(
                f"raw.toml: corrections.{name} has {len(value)} numbers, expected {count}, or none"
            )
    if config == CorrectionsConfig() or not any(fnmatchcase(drive.name, glob) for glob in config.drives):
        return drive
    return CorrectedDrive(drive, config, axes, pose_axes)


def signed_axes(names: Sequence[str], key: str) -> Floats:
    """Return the (3, 3) matrix that takes coordinates along other axes to forward, left and up.

    Args:
        names: Each of the three in terms of the others: "-y" is against the other y axis.
        key: Name of the setting, for the message.

    Raises:
        BadSetting: They are not x, y and z, each once.
    """
    letters = [name.removeprefix("-") for name in names]
    if sorted(letters) != list(_LETTERS):
        raise BadSetting(
            f"raw.toml: corrections.{key} = {list(names)}, expected x, y and z, each once, with or without -: "
            'axes = ["y", "-x", "z"] is for points whose y axis is forward'
        )
    matrix = np.zeros((3, 3))
    for row, (name, letter) in enumerate(zip(names, letters, strict=True)):
        matrix[row, _LETTERS.index(letter)] = -1.0 if name.startswith("-") else 1.0
    return matrix


class CorrectedDrive:
    """A drive whose points, poses and times are corrected; all else is the drive's own."""

    def __init__(self, drive: Drive, config: CorrectionsConfig, axes: Floats, pose_axes: Floats) -> None:
        """Take the drive and what is said against it.

        Args:
            drive: The drive as its data set gives it.
            config: The corrections.
            axes: (3, 3) from the axes of its points to ego axes.
            pose_axes: (3, 3) from the car's axes of its poses to ego axes.
        """
        self._drive, self._config, self._axes, self._pose_axes = drive, config, axes, pose_axes

    @property
    def name(self) -> str:
        """Name of the segment."""
        return self._drive.name

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The frames."""
        return self._drive.frames

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras."""
        return self._drive.cameras

    @property
    def skipped(self) -> Mapping[str, int]:
        """What was left out."""
        return self._drive.skipped

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that can be read."""
        return self._drive.files

    @cached_property
    def ground_z_m(self) -> float:
        """Height of the road in ego axes: as the user says, or as the drive says in the corrected unit and axes."""
        if self._config.ground_z_m:
            return self._config.ground_z_m[0]
        up = self._axes[2]
        is_along_z = abs(up[2]) > 0
        return float(self._drive.ground_z_m * self._config.metres_per_unit * (up[2] if is_along_z else 1.0))

    @cached_property
    def world_from_ego(self) -> Array | None:
        """(T, 4, 4) corrected poses."""
        given, config = self._drive.world_from_ego, self._config
        if given is None or config.poses == "ignored":
            return None
        poses = np.array(given, dtype=np.float64)
        if config.poses == "ego_from_world":
            poses = inverse(poses)
        poses[:, :3, 3] *= config.pose_metres_per_unit
        if config.pose_delay_s:
            times_ns = [frame.time_ns for frame in self.frames]
            delay_ns = round(config.pose_delay_s * 1e9)
            poses = np.array([pose_at(times_ns, poses, time_ns + delay_ns) for time_ns in times_ns])
        return self._along_ego_axes(poses)

    def _along_ego_axes(self, poses: Array) -> Array:
        """Return poses of the ego axes; where the car's axes are mirrored, so is the world."""
        turn = np.eye(4)
        turn[:3, :3] = self._pose_axes
        turned = compose(poses, inverse(turn))
        if np.linalg.det(self._pose_axes) < 0:
            turned = compose(np.diag([1.0, -1.0, 1.0, 1.0]), turned)
        return turned

    def points(self, frame: int) -> Points:
        """Return the corrected sweep of the frame of that index, without the points on the car itself."""
        points, is_on_car = self._sweep(frame)
        return points[~is_on_car] if is_on_car.any() else points

    def _sweep(self, frame: int) -> tuple[Points, Bools]:
        """Return all points of a frame, corrected, and which of them lie on the car."""
        points = self._corrected(self._points(frame))
        xyz_m = self._moved_to_frame(frame, points.xyz_ego_m, points.time_offset_ns)
        return replace(points, xyz_ego_m=xyz_m), self._is_on_car(xyz_m)

    def _corrected(self, points: Points) -> Points:
        """Return points in metres along the ego axes, with intensities up to 1."""
        # Without BLAS, whose last digit depends on the processor: each ego axis is one column with a sign.
        column, sign = np.abs(self._axes).argmax(axis=1), self._axes.sum(axis=1)
        xyz_m = points.xyz_ego_m[:, column] * (sign * self._config.metres_per_unit)
        intensity = np.clip(points.intensity / self._config.intensity_full, 0, 1)
        return replace(points, xyz_ego_m=xyz_m, intensity=intensity)

    def _points(self, frame: int) -> Points:
        """Return the sweep as the data set gives it; poses that are ignored have not moved its points either."""
        measured = None
        if self._config.poses == "ignored" and isinstance(self._drive, UncompensatedSweeps):
            measured = self._drive.measured_points(frame)
        return self._drive.points(frame) if measured is None else measured

    def measured_points(self, frame: int) -> Points | None:
        """Return the corrected sweep with each point where it was measured; None where the files do not hold that."""
        measured = (
            self._drive.measured_points(frame) if isinstance(self._drive, UncompensatedSweeps) else None
        )
        if measured is None or self._config.motion_compensation != "as-given":
            return None
        corrected = self._corrected(measured)
        return corrected[~self._is_on_car(corrected.xyz_ego_m)]

    def _moved_to_frame(self, frame: int, xyz_m: Array, offset_ns: Array) -> Array:
        poses, method = self.world_from_ego, self._config.motion_compensation
        if poses is None or method == "as-given":
            return xyz_m
        step = [known.index for known in self.frames].index(frame)
        times_ns = [known.time_ns for known in self.frames]
        return compensate(xyz_m, offset_ns if method == "apply" else -offset_ns, step, times_ns, poses)

    def _is_on_car(self, xyz_m: Array) -> Bools:
        if not self._config.car_m:
            return np.zeros(len(xyz_m), dtype=np.bool_)
        behind, ahead, right, left = self._config.car_m
        x_m, y_m = xyz_m[:, 0], xyz_m[:, 1]
        return np.asarray((x_m > behind) & (x_m < ahead) & (y_m > right) & (y_m < left))

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of that camera with its corrected time, or None where it is missing."""
        image = self._drive.image(frame, camera)
        if image is None:
            return None
        return replace(image, time_ns=image.time_ns + round(self._config.picture_delay_s * 1e9))

    def pixels(self, frame: int, camera: str) -> Floats | None:
        """Return the data set's own pixels of the points that are left; None where it knows none."""
        pixels = self._drive.pixels(frame, camera) if isinstance(self._drive, PixelSource) else None
        if pixels is None or not self._config.car_m:
            return pixels
        return np.asarray(pixels[~self._sweep(frame)[1]])

    def ground_z(self, frame: int, xyz_ego_m: Array) -> Floats:
        """Return the data set's own height of the ground; NaN where it knows none."""
        is_plain = self._config.metres_per_unit == 1 and np.array_equal(self._axes, np.eye(3))
        if isinstance(self._drive, GroundSource) and is_plain:
            return self._drive.ground_z(frame, xyz_ego_m)
        return np.full(len(xyz_ego_m), np.nan)

    @property
    def skipped_points(self) -> Mapping[int, Mapping[str, int]]:
        """How many points the data set left out of each sweep that was read, by frame and reason."""
        return self._drive.skipped_points if isinstance(self._drive, IncompleteSweeps) else {}
