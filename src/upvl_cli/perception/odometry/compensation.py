"""Motion compensation by the poses of odometry, where these are not the drive's own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Protocol

import numpy as np

from upvl_cli.geometry.motion_compensation import compensate
from upvl_cli.perception.odometry.source import UncompensatedSweeps
from upvl_cli.types import Array, Drive, Points


class FramePose(Protocol):
    """The pose of one frame."""

    @property
    def frame(self) -> int:
        """Index of the frame."""

    @property
    def time_ns(self) -> int:
        """Time of its sweep."""

    @property
    def world_from_ego(self) -> Array:
        """(4, 4) pose of the car."""


def compensated_points(drive: Drive, poses: Iterable[FramePose]) -> Callable[[int], Points]:
    """Return the function that gives the sweep of a frame, its points where they were at the frame's time.

    A drive moves its points by its own poses. Where it has none, or odometry refined or replaced them, points that it
    can give as they were measured are moved by the poses of odometry.

    Args:
        drive: The drive.
        poses: The pose of each of its frames.
    """
    if not isinstance(drive, UncompensatedSweeps):
        return drive.points
    rows = list(poses)
    world_from_ego = np.array([row.world_from_ego for row in rows])
    given = drive.world_from_ego
    if given is not None and np.array_equal(given, world_from_ego):
        return drive.points
    times_ns = [row.time_ns for row in rows]
    step_of = {row.frame: step for step, row in enumerate(rows)}

    def points(frame: int) -> Points:
        measured = drive.measured_points(frame)
        if measured is None:
            return drive.points(frame)
        step, offset_ns = step_of[frame], measured.time_offset_ns
        return replace(
            measured, xyz_ego_m=compensate(measured.xyz_ego_m, offset_ns, step, times_ns, world_from_ego)
        )

    return points
