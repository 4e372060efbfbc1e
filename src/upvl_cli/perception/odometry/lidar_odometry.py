"""LiDAR odometry: the pose of the car at each sweep, from the sweeps alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from upvl_cli.geometry.se3 import compose
from upvl_cli.perception.odometry.config import LidarOdometryConfig
from upvl_cli.perception.odometry.constant_velocity import motion_over, velocity_between
from upvl_cli.perception.odometry.start import search_start
from upvl_cli.perception.odometry.sweep import PreparedSweep
from upvl_cli.perception.odometry.tracker import Placement, Tracker
from upvl_cli.perception.odometry.trajectory import Trajectory
from upvl_cli.types import Array


def estimate_trajectory(sweeps: Iterable[PreparedSweep], config: LidarOdometryConfig) -> Trajectory:
    """Estimate the pose of each sweep; the first sweep's axes are the world's.

    Registration is KISS-ICP's; the motion is predicted by time. At the start, after a gap and where a registration
    fits badly or is no motion of a car, motions are searched without a guess. A sweep that fits nowhere is not placed:
    its pose is interpolated between those that are.

    Args:
        sweeps: The sweeps in order of time; a few are held at a time.
        config: The method's settings.
    """
    placements = _interpolate(list(_place_all(iter(sweeps), config)))
    sigmas = [_sigmas(placements, step, config) for step in range(len(placements))]
    agreements = [placement.agreement for placement in placements]
    return Trajectory(
        world_from_ego=np.array([placement.world_from_ego for placement in placements]).reshape(-1, 4, 4),
        is_placed=np.array([placement.is_placed for placement in placements], dtype=bool),
        is_bridged=np.array([placement.is_bridged for placement in placements], dtype=bool),
        residual_m=np.array([np.nan if each is None else each.rmse_m() for each in agreements]),
        inlier_share=np.array([np.nan if each is None else each.inlier_share for each in agreements]),
        position_sigma_m=np.array([sigma[0] for sigma in sigmas]),
        heading_sigma_rad=np.array([sigma[1] for sigma in sigmas]),
    )


def _place_all(sweeps: Iterator[PreparedSweep], config: LidarOdometryConfig) -> Iterator[Placement]:
    """Yield the placement of each sweep; a new start is searched where nothing was placed for long."""
    window = deque(islice(sweeps, config.search.sweeps))
    tracker: Tracker | None = None
    pose, twist = np.eye(4), np.zeros(6)
    while window:
        sweep = window[0]
        if tracker is None:
            start = search_start(list(window), [twist], config) if len(window) > 1 else None
            if start is not None:
                tracker, twist = Tracker(sweep, pose, start, config), start
            yield Placement(sweep.time_s, pose, twist, start is not None, False, None)
        else:
            placement = tracker.place(sweep)
            pose, twist = placement.world_from_ego, placement.twist
            yield placement
            if sweep.time_s - tracker.last_time_s > config.placement.give_up_s:
                tracker = None
        window.popleft()
        window.extend(islice(sweeps, 1))
        if tracker is None and window:
            pose = compose(pose, motion_over(twist, window[0].time_s - sweep.time_s))


def _interpolate(placements: list[Placement]) -> list[Placement]:
    """Return the placements; those without a pose of their own lie on the motion between the placed ones around.

    After the last placed one the predicted poses stay; before the first one its motion is taken back.
    """
    placed = [step for step, placement in enumerate(placements) if placement.is_placed]
    result = list(placements)
    for step, placement in enumerate(placements):
        if placement.is_placed or not placed:
            continue
        after = next((known for known in placed if known > step), None)
        before = next((known for known in reversed(placed) if known < step), None)
        if after is None:
            continue
        later = placements[after]
        twist = later.twist
        if before is not None:
            earlier = placements[before]
            seconds = later.time_s - earlier.time_s
            twist = velocity_between(earlier.world_from_ego, later.world_from_ego, seconds)
        motion = motion_over(twist, placement.time_s - later.time_s)
        pose = compose(later.world_from_ego, motion)
        result[step] = replace(placement, world_from_ego=pose, twist=twist)
    return result


def _sigmas(placements: list[Placement], step: int, config: LidarOdometryConfig) -> tuple[float, float]:
    """Return the standard deviations of the step from the placed frame before, in m and rad.

    By the fit where the frame was placed; else by what a car's motion can be off a constant one: from rest at both
    ends a s² / 8 between two known poses, and a s² / 2 where only one is known.
    """
    placement, limits = placements[step], config.placement
    if placement.is_placed and placement.agreement is not None:
        return placement.agreement.sigmas
    before = [known.time_s for known in placements[:step] if known.is_placed]
    after = [known.time_s for known in placements[step + 1 :] if known.is_placed]
    if placement.is_placed and not before:
        return 0.0, 0.0
    if not before and not after:
        return float("inf"), float("inf")
    if before and after and not placement.is_placed:
        share = (after[0] - before[-1]) ** 2 / 8
    else:
        share = (placement.time_s - before[-1] if before else after[0] - placement.time_s) ** 2 / 2
    return share * limits.max_acceleration_mps2, share * limits.max_yaw_acceleration_radps2
