"""Points are moved by the poses of odometry only where these are not the drive's own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import world
from upvl_cli.geometry.motion_compensation import compensate
from upvl_cli.perception.odometry.compensation import compensated_points
from upvl_cli.types import Array, Points

POSES = world.drive().world_from_ego
TIMES_NS = [frame.time_ns for frame in world.drive().frames]


@dataclass
class Row:
    frame: int
    time_ns: int
    world_from_ego: Array


class TwistedDrive:
    """The tests' street as a turning LiDAR measures it; `points` is what wrong poses make of it."""

    def __init__(self, world_from_ego: Array | None) -> None:
        self.world_from_ego = world_from_ego

    def points(self, frame: int) -> Points:
        points = world.sweep(frame)[0]
        return replace(points, xyz_ego_m=points.xyz_ego_m + 1.0)

    def measured_points(self, frame: int) -> Points | None:
        points = world.sweep(frame)[0]
        offset_ns = np.linspace(-4e7, 4e7, len(points)).astype(np.int64)
        xyz_m = compensate(points.xyz_ego_m, -offset_ns, frame, TIMES_NS, POSES)
        return replace(points, xyz_ego_m=xyz_m, time_offset_ns=offset_ns) if frame < 5 else None


def rows(poses: Array) -> list[Row]:
    return [
        Row(step, time_ns, pose) for step, (time_ns, pose) in enumerate(zip(TIMES_NS, poses, strict=True))
    ]


def test_poses_of_odometry_move_what_was_measured() -> None:
    for given in (None, POSES + 1e-3):
        points_of = compensated_points(TwistedDrive(given), rows(POSES))
        truth = world.sweep(3)[0].xyz_ego_m
        # The sweep was twisted to first order: back within two centimetres, and by half a metre without.
        np.testing.assert_allclose(points_of(3).xyz_ego_m, truth, atol=0.02)
        measured = TwistedDrive(given).measured_points(3)
        assert measured is not None
        assert np.abs(measured.xyz_ego_m - truth).max() > 0.1


def test_a_drive_moves_its_points_by_its_own_poses() -> None:
    drive = TwistedDrive(POSES)
    assert compensated_points(drive, rows(POSES)) == drive.points
    plain = world.drive()
    assert compensated_points(plain, rows(POSES + 1e-3)) == plain.points


def test_a_sweep_that_was_not_measured_so_is_taken_as_it_is() -> None:
    drive = TwistedDrive(None)
    points_of = compensated_points(drive, rows(POSES))
    np.testing.assert_array_equal(points_of(5).xyz_ego_m, drive.points(5).xyz_ego_m)
