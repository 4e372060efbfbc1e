"""Where the car is at each frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from upvl_cli.config.base import Config, setting, table
from upvl_cli.perception.odometry.config import LidarOdometryConfig, PathSmoothingConfig, RefinementConfig
from upvl_cli.pipeline.stage import Stage
from upvl_cli.stages.rows import OdometryRow

if TYPE_CHECKING:
    from upvl_cli.perception.odometry.trajectory import EstimatedPath
    from upvl_cli.pipeline.stage import Inputs
    from upvl_cli.types import Array, Drive, Floats, Frame


@dataclass(frozen=True)
class OdometryConfig(Config):
    """Settings of `odometry`."""

    poses: Literal["given", "estimated", "refined"] = setting(
        "where poses come from",
        effects={
            "given": "from the data set, and from the sweeps where it has none",
            "estimated": "from the sweeps alone",
            "refined": "steps from the sweeps, and the axes and the shape over long times from the data set: for "
            "poses that are rough but do not drift",
        },
    )
    lidar: LidarOdometryConfig = table("estimate of the poses from the sweeps")
    smoothing: PathSmoothingConfig = table("smoothing of the estimated positions")
    refinement: RefinementConfig = table("refinement of given poses")


def run(inputs: Inputs, config: OdometryConfig) -> Iterator[OdometryRow]:
    """Take the poses of the drive, or estimate or refine them by its sweeps, and measure how well the sweeps agree."""
    import numpy as np

    drive = inputs.drive
    for reason, items in drive.skipped.items():
        inputs.count(reason, items)
    given = drive.world_from_ego
    without = np.full((len(drive.frames), 2), np.nan)
    if given is None or config.poses == "estimated":
        path, before = _estimate(drive, config), without
        inputs.count("poses estimated", len(path))
    elif config.poses == "given":
        path = _measure(drive, given, config, lambda frame: _points(drive, frame, measured=False))
        before = np.column_stack([path.residual_m, path.inlier_share])
        inputs.count("poses given", len(path))
    else:
        path, before = _refine(inputs, given, config)
    for reason, frames in (
        ("frames placed after a gap or by a new search", path.is_bridged),
        ("frames that could not be placed, poses interpolated", ~path.is_placed),
    ):
        if frames.any():
            inputs.count(reason, frames.sum())
    for step, frame in enumerate(drive.frames):
        yield OdometryRow(
            inputs.segment,
            frame.index,
            frame.time_ns,
            path.world_from_ego[step],
            is_placed=bool(path.is_placed[step]),
            residual_m=float(path.residual_m[step]),
            residual_given_m=float(before[step, 0]),
            inlier_share=float(path.inlier_share[step]),
            inlier_share_given=float(before[step, 1]),
            position_sigma_m=float(path.position_sigma_m[step]),
            heading_sigma_rad=float(path.heading_sigma_rad[step]),
        )


def _points(drive: Drive, frame: Frame, *, measured: bool) -> tuple[Floats, Floats]:
    """Return the points of a sweep and the seconds at which each was measured; zeros where compensated."""
    import numpy as np

    from upvl_cli.perception.odometry.source import UncompensatedSweeps

    if measured and isinstance(drive, UncompensatedSweeps):
        points = drive.measured_points(frame.index)
        if points is not None:
            return points.xyz_ego_m, points.time_offset_ns / 1e9
    points = drive.points(frame.index)
    return points.xyz_ego_m, np.zeros(len(points))


def _times_s(drive: Drive) -> Floats:
    """Return the (T,) times of the frames after the first, which lose no digit in seconds."""
    import numpy as np

    return np.array([(frame.time_ns - drive.frames[0].time_ns) / 1e9 for frame in drive.frames])


def _estimate(drive: Drive, config: OdometryConfig) -> EstimatedPath:
    from upvl_cli.perception.odometry.lidar_odometry import estimate_trajectory
    from upvl_cli.perception.odometry.sweep import PreparedSweep, prepare_sweep
    from upvl_cli.runtime.parallel import in_order

    lidar, time_s = config.lidar, _times_s(drive)

    def prepare(step: int) -> PreparedSweep:
        xyz_ego_m, offset_s = _points(drive, drive.frames[step], measured=True)
        return prepare_sweep(xyz_ego_m, offset_s, float(time_s[step]), lidar.kiss_icp, lidar.structure)

    return estimate_trajectory(in_order(prepare, range(len(time_s))), lidar, config.smoothing)


def _measure(
    drive: Drive, poses: Array, config: OdometryConfig, points: Callable[[Frame], tuple[Floats, Floats]]
) -> EstimatedPath:
    """Return poses with how well the sweeps, as `points` gives them, agree."""
    from upvl_cli.perception.odometry.measurement import measure_trajectory
    from upvl_cli.perception.odometry.sweep import Cloud, prepare_structure
    from upvl_cli.runtime.parallel import in_order

    lidar = config.lidar

    def prepare(frame: Frame) -> Cloud:
        return prepare_structure(*points(frame), lidar.kiss_icp, lidar.structure)

    return measure_trajectory(in_order(prepare, drive.frames), poses, _times_s(drive), lidar.agreement)


def _refine(inputs: Inputs, given: Array, config: OdometryConfig) -> tuple[EstimatedPath, Floats]:
    """Return the path of refined poses, and residual and share of inliers of each frame with the given ones."""
    from dataclasses import replace

    import numpy as np

    from upvl_cli.perception.odometry.refinement import refine_poses

    drive = inputs.drive
    estimated = _estimate(drive, config)
    result = refine_poses(given, estimated.world_from_ego, _times_s(drive), config.refinement)

    def points(frame: Frame) -> tuple[Floats, Floats]:
        return _points(drive, frame, measured=True)

    before = _measure(drive, given, config, points)
    after = _measure(drive, result.world_from_ego, config, points)
    inputs.count("poses refined", len(given))
    is_better = after.inlier_share > before.inlier_share
    inputs.count("poses that the sweeps agree with better than with the given ones", is_better.sum())
    if not result.agrees:
        inputs.count("given poses whose shape the sweeps contradict: it was not used", len(given))
    path = replace(after, is_placed=estimated.is_placed, is_bridged=estimated.is_bridged)
    return path, np.column_stack([before.residual_m, before.inlier_share])


STAGE = Stage(name="odometry", run=run, config=OdometryConfig, row=OdometryRow, reads=("raw",))
