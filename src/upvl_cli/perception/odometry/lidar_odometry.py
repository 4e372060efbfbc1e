"""LiDAR odometry: the pose of the car at each sweep, from the sweeps alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from upvl_cli.geometry.se3 import compose, inverse, yaw_of
from upvl_cli.perception.odometry.config import LidarOdometryConfig, PathSmoothingConfig
from upvl_cli.perception.odometry.constant_velocity import motion_over
from upvl_cli.perception.odometry.interpolation import interpolate, sigmas_of
from upvl_cli.perception.odometry.smoothing import smooth_path
from upvl_cli.perception.odometry.start import search_start
from upvl_cli.perception.odometry.sweep import PreparedSweep
from upvl_cli.perception.odometry.tracker import Placement, Tracker
from upvl_cli.perception.odometry.trajectory import EstimatedPath
from upvl_cli.types import Array, Floats


def estimate_trajectory(
    sweeps: Iterable[PreparedSweep], config: LidarOdometryConfig, smoothing: PathSmoothingConfig
) -> EstimatedPath:
    """Estimate the pose of each sweep; the first sweep's axes are the world's.

    Registration is KISS-ICP's; the motion is predicted by time. At the start, after a gap and where a registration
    fits badly or is no motion of a car, motions are searched without a guess. A sweep that fits nowhere is not placed:
    its pose is interpolated between those that are.

    Args:
        sweeps: The sweeps in order of time; a few are held at a time.
        config: The method's settings.
        smoothing: Smoothing of the positions.
    """
    placements = interpolate(list(_place_all(iter(sweeps), config)))
    registered = np.array([placement.world_from_ego for placement in placements]).reshape(-1, 4, 4)
    time_s = np.array([placement.time_s for placement in placements])
    is_placed = np.array([placement.is_placed for placement in placements], dtype=bool)
    poses = smooth_path(registered, time_s, is_placed, smoothing)
    agreements = [placement.agreement for placement in placements]
    sigmas = np.array([sigmas_of(placements, step, config.placement) for step in range(len(placements))])
    return EstimatedPath(
        world_from_ego=poses,
        is_placed=is_placed,
        is_bridged=np.array([placement.is_bridged for placement in placements], dtype=bool),
        residual_m=_residuals_m(placements, registered, poses),
        inlier_share=np.array([np.nan if each is None else each.inlier_share for each in agreements]),
        position_sigma_m=sigmas.reshape(-1, 2)[:, 0],
        heading_sigma_rad=sigmas.reshape(-1, 2)[:, 1],
    )


def _residuals_m(placements: Sequence[Placement], registered: Array, poses: Array) -> Floats:
    """Return the (T,) residuals under smoothed poses, from what was measured under the registered ones."""
    residuals = np.full(len(placements), np.nan)
    step_of = {placement.time_s: step for step, placement in enumerate(placements)}
    for step, placement in enumerate(placements):
        if placement.agreement is not None:
            before = step_of[placement.reference_s]
            was, now = (compose(inverse(each[before]), each[step]) for each in (registered, poses))
            moved = compose(now, inverse(was))
            residuals[step] = placement.agreement.rmse_m(np.array([*moved[:2, 3], yaw_of(moved)]))
    return residuals


def _place_all(sweeps: Iterator[PreparedSweep], config: LidarOdometryConfig) -> Iterator[Placement]:
    """Yield the placement of each sweep; a new start is searched where nothing was placed for long."""
    window = deque(islice(sweeps, config.search.sweeps))
    tracker: Tracker | None = None
    pose: Array = np.eye(4)
    twist: Floats = np.zeros(6)
    is_first = True
    while window:
        sweep = window[0]
        if tracker is None:
            start = search_start(list(window), [twist], config) if len(window) > 1 else None
            if start is not None:
                tracker, twist = Tracker(sweep, pose, start, config), start
            is_alone = is_first and len(window) == 1  # a drive of one sweep: nothing can contradict its pose
            yield Placement(sweep.time_s, pose, twist, is_alone or start is not None, False, None)
        else:
            placement = tracker.place(sweep)
            pose, twist = placement.world_from_ego, placement.twist
            yield placement
            if sweep.time_s - tracker.last_time_s > config.placement.give_up_s:
                tracker = None
        is_first = False
        window.popleft()
        window.extend(islice(sweeps, 1))
        if tracker is None and window:
            pose = compose(pose, motion_over(twist, window[0].time_s - sweep.time_s))
