"""What is wrong with a drive before it is labelled: its times, its pictures, its calibration; without any label."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.commands.check_config import CheckConfig, SampleConfig
from upvl_cli.config.toml import load
from upvl_cli.perception.drive_check.cameras import check_cameras
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.sample import DriveSample, spread_runs
from upvl_cli.pipeline.tables import Table
from upvl_cli.stages.rows import OdometryRow
from upvl_cli.types import Array

if TYPE_CHECKING:
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Drive

_SWEEPS, _PICTURES = 100, 100  # held in memory at most


def check(workspace: Workspace, segment: str) -> Iterator[Finding]:
    """Yield the findings on a drive: first on its frames, then on each camera.

    Args:
        workspace: Names the dataset, and holds check.toml; a drive without poses uses those of `odometry`, where
            they were made.
        segment: Name of the drive.

    Raises:
        BadInput: The drive cannot be read.
    """
    drive = workspace.drive(segment)
    poses = drive.world_from_ego
    path = workspace.shard("odometry", segment)
    if poses is None and path.is_file():
        table = Table(path, OdometryRow)
        if table.frames == tuple(frame.index for frame in drive.frames):
            poses = np.array([row.world_from_ego for row in table])
    yield from check_drive(drive, poses, load(CheckConfig, workspace.stages / "check.toml"))


def check_drive(drive: Drive, poses: Array | None, config: CheckConfig) -> Iterator[Finding]:
    """Yield the findings on a drive; cameras are checked only where times ascend.

    Args:
        drive: The drive.
        poses: (T, 4, 4) poses of its frames, if there are any.
        config: Settings of the check.
    """
    on_frames = list(_frames(drive))
    yield from on_frames
    if any(finding.is_fault for finding in on_frames):
        return
    if not drive.cameras:
        yield Finding("sensor", "ok", "the drive has no camera")
    yield from check_cameras(sample_drive(drive, poses, config.sample), config.camera)


def sample_drive(drive: Drive, poses: Array | None, config: SampleConfig) -> DriveSample:
    """Return a sample of a drive; sweeps and pictures are read when they are asked for."""
    frames = drive.frames
    return DriveSample(
        frames=frames,
        world_from_ego=poses,
        ground_z_m=drive.ground_z_m,
        cameras=drive.cameras,
        runs=spread_runs(len(frames), config.runs, config.sweeps),
        sweep=lru_cache(_SWEEPS)(lambda step: drive.points(frames[step].index)),
        picture=lru_cache(_PICTURES)(lambda step, camera: drive.image(frames[step].index, camera)),
    )


def _frames(drive: Drive) -> Iterator[Finding]:
    """Yield what was left out of a drive, and times that go back."""
    for reason, count in drive.skipped.items():
        yield Finding("clock", "ok", f"{count} left out: {reason}")
    steps_ns = np.diff([frame.time_ns for frame in drive.frames])
    back = np.flatnonzero(steps_ns <= 0)
    if len(back):
        after = drive.frames[back[0] + 1].index
        text = f"frame {after} is not later than the one before it ({len(back)} such)"
        yield Finding("clock", "fault", text, remedy="look at the time stamps")
