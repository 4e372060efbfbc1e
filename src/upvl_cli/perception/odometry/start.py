"""Search of the motion at the start of a path: each start is followed over some sweeps and judged by how they agree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.perception.odometry.config import LidarOdometryConfig
from upvl_cli.perception.odometry.constant_velocity import velocity_between
from upvl_cli.perception.odometry.motion_search import Reach, search_motion
from upvl_cli.perception.odometry.sweep import PreparedSweep
from upvl_cli.perception.odometry.tracker import Tracker
from upvl_cli.types import Floats


def search_start(
    sweeps: Sequence[PreparedSweep], guesses: Sequence[Floats], config: LidarOdometryConfig
) -> Floats | None:
    """Return the (6,) velocity of the car at the first sweep; None where nothing makes the first two agree.

    Args:
        sweeps: The first sweeps, at least two.
        guesses: (6,) velocities that are tried beside those that a search finds, and that of a car that stands.
        config: The method's settings.
    """
    seconds = sweeps[1].time_s - sweeps[0].time_s
    search = config.search
    reach = Reach(search.max_speed_mps * seconds, search.max_turn_radps * seconds)
    motions = search_motion(
        sweeps[0].structure.xyz_m, sweeps[1].structure.xyz_m, np.eye(4), reach, search
    )
    starts = [np.zeros(6), *guesses, *(velocity_between(np.eye(4), motion, seconds) for motion in motions)]
    best, lowest_m2 = None, np.inf
    for start in starts:
        error_m2, velocity = _follow(sweeps, start, config)
        speed = float(np.linalg.norm(velocity[:3])) / search.max_speed_mps
        if error_m2 * (1 + search.preference * speed) < lowest_m2:
            best, lowest_m2 = velocity, error_m2 * (1 + search.preference * speed)
    return best


def _follow(
    sweeps: Sequence[PreparedSweep], start: Floats, config: LidarOdometryConfig
) -> tuple[float, Floats]:
    """Return how badly sweeps agree that are followed from a start, and the first velocity found; infinite for no fit."""
    tracker = Tracker(sweeps[0], np.eye(4), start, config)
    placements = [tracker.follow(sweep) for sweep in sweeps[1:]]
    agreements = [placement.agreement for placement in placements if placement.agreement is not None]
    first = agreements[0]
    if first.is_measured and first.inlier_share < config.placement.min_inlier_share:
        return float("inf"), placements[0].twist
    errors = [agreement.error_m2(config.agreement.partner_m) for agreement in agreements]
    return float(np.mean(errors)), placements[0].twist
