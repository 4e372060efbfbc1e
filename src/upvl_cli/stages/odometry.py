"""Where the car is at each frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from upvl_cli.stage import Row, Stage, column, param

if TYPE_CHECKING:
    from upvl_cli.inputs import Inputs
    from upvl_cli.types import Array


@dataclass(frozen=True)
class OdometryParams:
    """Settings of `odometry`."""

    voxel_m: float = param("edge of the voxels of the local map", "m", least=0.01, most=10)
    min_range_m: float = param("nearer points are left out: they are the car itself", "m", least=0, most=1000)
    max_range_m: float = param("farther points are left out", "m", least=1, most=1000)
    smooth_frames: int = param(
        "frames on each side whose path an estimated place is drawn to; 0 draws it to none",
        least=0,
        most=1000,
    )


@dataclass(frozen=True)
class OdometryRow(Row):
    """Time and pose of one frame."""

    time_ns: int = column("int64", "time of the sweep, from any fixed origin", "ns")
    world_from_ego: Array = column("float64", "pose of the car", "m", shape=(4, 4))


def run(inputs: Inputs, params: OdometryParams) -> Iterator[OdometryRow]:
    """Pass the drive's poses through, or estimate them from the sweeps where it has none."""
    import numpy as np

    drive = inputs.drive
    for reason, items in drive.skipped.items():
        inputs.count(reason, items)
    poses = drive.world_from_ego
    if poses is None:
        from upvl_cli.algorithms.odometry import odometry, smoothed

        measured = odometry(
            (drive.points(frame.index).xyz_ego_m for frame in drive.frames),
            voxel_m=params.voxel_m,
            min_range_m=params.min_range_m,
            max_range_m=params.max_range_m,
        )
        poses = smoothed(
            measured, at=np.array([frame.index for frame in drive.frames]), reach=params.smooth_frames
        )
        inputs.count("poses estimated", len(poses))
    else:
        inputs.count("poses given", len(poses))
    for frame, pose in zip(drive.frames, poses, strict=True):
        yield OdometryRow(inputs.segment, frame.index, frame.time_ns, pose)


STAGE = Stage(name="odometry", run=run, params=OdometryParams, row=OdometryRow, reads=("raw",))
