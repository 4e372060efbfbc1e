"""Where the car is at each frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.config.base import Config, table
from upvl_cli.perception.odometry.config import KissIcpConfig, PathSmoothingConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import OdometryRow

if TYPE_CHECKING:
    from upvl_cli.pipeline.stage import Inputs


@dataclass(frozen=True)
class OdometryConfig(Config):
    """Settings of `odometry`, for drives without poses of their own."""

    kiss_icp: KissIcpConfig = table("estimate of the poses from the sweeps")
    smoothing: PathSmoothingConfig = table("smoothing of the estimated positions")


def run(inputs: Inputs, config: OdometryConfig) -> Iterator[OdometryRow]:
    """Pass the drive's poses through, or estimate them from the sweeps where it has none."""
    import numpy as np

    drive = inputs.drive
    for reason, items in drive.skipped.items():
        inputs.count(reason, items)
    poses = drive.world_from_ego
    if poses is None:
        from upvl_cli.perception.odometry.lidar_odometry import estimate_poses
        from upvl_cli.perception.odometry.smoothing import smooth_path

        sweeps = (drive.points(frame.index).xyz_ego_m for frame in drive.frames)
        numbers = np.array([frame.index for frame in drive.frames])
        poses = smooth_path(estimate_poses(sweeps, config.kiss_icp), numbers, config.smoothing)
        inputs.count("poses estimated", len(poses))
    else:
        inputs.count("poses given", len(poses))
    for frame, pose in zip(drive.frames, poses, strict=True):
        yield OdometryRow(inputs.segment, frame.index, frame.time_ns, pose)


STAGE = Stage(name="odometry", run=run, config=OdometryConfig, row=OdometryRow, reads=("raw",))
