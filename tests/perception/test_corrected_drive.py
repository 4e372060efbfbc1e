"""Corrections of raw.toml: each undoes what was done to a drive on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import world
from upvl_cli.config.corrections import CorrectionsConfig
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.motion_compensation import compensate
from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import inverse
from upvl_cli.perception.corrected_drive import correct
from upvl_cli.types import Array, Drive, Points

PLAIN = CorrectionsConfig()


class ChangedDrive:
    """The tests' street with other points and poses."""

    def __init__(
        self,
        points: Callable[[int, Points], Points] = lambda _, points: points,
        poses: Callable[[Array], Array] = lambda poses: poses,
        **others: Any,
    ) -> None:
        drive = world.drive()
        self.name, self.frames, self.cameras = drive.name, drive.frames, drive.cameras
        self.skipped, self.files, self.ground_z_m = drive.skipped, drive.files, drive.ground_z_m
        self.world_from_ego: Array | None = poses(drive.world_from_ego)
        self._points = points
        self.__dict__.update(others)

    def points(self, frame: int) -> Points:
        return self._points(frame, world.sweep(frame)[0])

    def image(self, frame: int, camera: str) -> Any:
        return world.drive().image(frame, camera)


def moved(change: Callable[[Array], Array]) -> Callable[[int, Points], Points]:
    return lambda _, points: replace(points, xyz_ego_m=change(points.xyz_ego_m))


def assert_is_street(drive: Drive, *, atol_m: float = 1e-5) -> None:
    assert drive.world_from_ego is not None
    np.testing.assert_allclose(drive.world_from_ego, world.drive().world_from_ego, atol=1e-9)
    for frame in (0, 3):
        np.testing.assert_allclose(
            drive.points(frame).xyz_ego_m, world.sweep(frame)[0].xyz_ego_m, atol=atol_m
        )


def test_without_corrections_a_drive_is_itself() -> None:
    drive = world.drive()
    assert correct(drive, PLAIN) is drive
    assert correct(drive, replace(PLAIN, metres_per_unit=2.0, drives=("other-*",))) is drive


def test_feet_become_metres() -> None:
    drive = ChangedDrive(moved(lambda xyz: xyz / 0.3048), ground_z_m=1.0)
    corrected = correct(drive, replace(PLAIN, metres_per_unit=0.3048))
    assert_is_street(corrected)
    assert corrected.ground_z_m == pytest.approx(0.3048)


@pytest.mark.parametrize(
    ("axes", "turn"),
    [
        (("y", "-x", "z"), lambda x, y, z: (-y, x, z)),  # the file's y axis is forward
        (("z", "-x", "-y"), lambda x, y, z: (-y, -z, x)),  # as a camera has its axes
        (("x", "-y", "z"), lambda x, y, z: (x, -y, z)),  # mirrored
    ],
)
def test_axes_of_points(axes: tuple[str, ...], turn: Callable[..., tuple[Array, ...]]) -> None:
    drive = ChangedDrive(moved(lambda xyz: np.stack(turn(*xyz.T), axis=1)))
    assert_is_street(correct(drive, replace(PLAIN, axes=axes)))


def test_axes_of_poses() -> None:
    turn = np.eye(4)
    turn[:3, :3] = [
        [0, 1, 0],
        [-1, 0, 0],
        [0, 0, 1],
    ]  # ego axes from those of the poses, whose y axis is forward
    drive = ChangedDrive(poses=lambda poses: poses @ turn)
    assert_is_street(correct(drive, replace(PLAIN, pose_axes=("y", "-x", "z"))))


def test_mirrored_axes_of_poses_leave_a_proper_motion() -> None:
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    drive = ChangedDrive(poses=lambda poses: mirror @ poses @ mirror)
    corrected = correct(drive, replace(PLAIN, pose_axes=("x", "-y", "z")))
    assert_is_street(corrected)


def test_inverted_and_scaled_poses() -> None:
    def change(poses: Array) -> Array:
        changed = poses.copy()
        changed[:, :3, 3] *= 1000.0
        return inverse(changed)

    config = replace(PLAIN, poses="ego_from_world", pose_metres_per_unit=0.001)
    assert_is_street(correct(ChangedDrive(poses=change), config))


def test_ignored_poses_have_not_moved_the_points_either() -> None:
    measured = world.sweep(2)[0]

    class MeasuredDrive(ChangedDrive):
        def measured_points(self, frame: int) -> Points | None:
            return measured if frame == 2 else None

    drive = MeasuredDrive(moved(lambda xyz: xyz + 1.0))
    corrected = correct(drive, replace(PLAIN, poses="ignored"))
    assert corrected.world_from_ego is None
    np.testing.assert_array_equal(corrected.points(2).xyz_ego_m, measured.xyz_ego_m)
    np.testing.assert_array_equal(corrected.points(1).xyz_ego_m, drive.points(1).xyz_ego_m)


def test_late_poses() -> None:
    times_ns = [frame.time_ns for frame in world.drive().frames]
    delay_ns = 50_000_000

    def change(poses: Array) -> Array:
        return np.array([pose_at(times_ns, poses, time_ns - delay_ns) for time_ns in times_ns])

    corrected = correct(ChangedDrive(poses=change), replace(PLAIN, pose_delay_s=0.05))
    inner = slice(1, -1)  # beyond the ends both go on in a straight line
    assert corrected.world_from_ego is not None
    np.testing.assert_allclose(
        corrected.world_from_ego[inner], world.drive().world_from_ego[inner], atol=0.02
    )


def test_intensity_car_and_ground() -> None:
    drive = ChangedDrive(lambda _, points: replace(points, intensity=points.intensity * 255))
    corrected = correct(
        drive, replace(PLAIN, intensity_full=255.0, car_m=(-5.0, 8.0, -4.0, 4.0), ground_z_m=(-1.5,))
    )
    points, whole = corrected.points(0), world.sweep(0)[0]
    near = (np.abs(whole.xyz_ego_m[:, 0] - 1.5) < 6.5) & (np.abs(whole.xyz_ego_m[:, 1]) < 4.0)
    assert 0 < near.sum() < len(whole)
    assert len(points) == len(whole) - near.sum()
    np.testing.assert_allclose(points.intensity, whole.intensity[~near], atol=1e-6)
    assert corrected.ground_z_m == -1.5


def test_motion_compensation_is_applied() -> None:
    poses = world.drive().world_from_ego
    times_ns = [frame.time_ns for frame in world.drive().frames]

    def twist(frame: int, points: Points) -> Points:
        offset_ns = np.linspace(-4e7, 4e7, len(points)).astype(np.int64)
        xyz_m = compensate(points.xyz_ego_m, -offset_ns, frame, times_ns, poses)
        return replace(points, xyz_ego_m=xyz_m, time_offset_ns=offset_ns)

    drive = ChangedDrive(twist)
    assert np.abs(drive.points(3).xyz_ego_m - world.sweep(3)[0].xyz_ego_m).max() > 0.1
    assert_is_street(correct(drive, replace(PLAIN, motion_compensation="apply")), atol_m=0.02)


def test_late_pictures() -> None:
    corrected = correct(ChangedDrive(), replace(PLAIN, picture_delay_s=0.05))
    image = corrected.image(2, "front")
    assert image is not None
    assert image.time_ns == world.drive().frames[2].time_ns + 50_000_000


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axes": ("x", "x", "z")}, r"corrections.axes = \['x', 'x', 'z'\], expected x, y and z, each once"),
        ({"pose_axes": ("x", "y")}, "corrections.pose_axes"),
        ({"car_m": (1.0, 2.0)}, "corrections.car_m has 2 numbers, expected 4"),
        ({"ground_z_m": (1.0, 2.0)}, "corrections.ground_z_m has 2 numbers, expected 1"),
    ],
)
def test_a_correction_that_makes_no_sense(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(BadSetting, match=message):
        correct(world.drive(), replace(PLAIN, **changes))
