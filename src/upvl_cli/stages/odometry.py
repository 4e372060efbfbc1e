"""Where the car is at each frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, setting
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import OdometryRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class OdometryConfig(Config):
    """Settings of `odometry`."""

    voxel_m: float = setting("edge of the voxels of the local map", "m", ge=0.01, le=10)
    min_range_m: float = setting("nearer points are left out: they are the car itself", "m", ge=0, le=1000)
    max_range_m: float = setting("farther points are left out", "m", ge=1, le=1000)
    smooth_frames: int = setting(
        "frames on each side whose path an estimated place is drawn to; 0 draws it to none",
        ge=0,
        le=1000,
    )


def run(inputs: Inputs, config: OdometryConfig) -> Iterator[OdometryRow]:
    """Pass the drive's poses through, or estimate them from the sweeps where it has none."""
    import numpy as np

    drive = inputs.drive
    for reason, items in drive.skipped.items():
        inputs.count(reason, items)
    poses = drive.world_from_ego
    if poses is None:
        from upvl_cli.perception.odometry import odometry, smoothed

        measured = odometry(
            (drive.points(frame.index).xyz_ego_m for frame in drive.frames),
            voxel_m=config.voxel_m,
            min_range_m=config.min_range_m,
            max_range_m=config.max_range_m,
        )
        poses = smoothed(
            measured, at=np.array([frame.index for frame in drive.frames]), reach=config.smooth_frames
        )
        inputs.count("poses estimated", len(poses))
    else:
        inputs.count("poses given", len(poses))
    for frame, pose in zip(drive.frames, poses, strict=True):
        yield OdometryRow(inputs.segment, frame.index, frame.time_ns, pose)


STAGE = Stage(name="odometry", run=run, config=OdometryConfig, row=OdometryRow, reads=("raw",))
