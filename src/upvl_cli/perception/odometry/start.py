"""Search of the motion at the start of a path: each start is followed over some sweeps and judged by how they agree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.perception.odometry.config import LidarOdometryConfig, SearchConfig
from upvl_cli.perception.odometry.constant_velocity import velocity_between
from upvl_cli.perception.odometry.motion_search import Reach, search_motion
from upvl_cli.perception.odometry.sweep import PreparedSweep
from upvl_cli.perception.odometry.tracker import MIN_POINTS, Tracker, is_believed
from upvl_cli.types import Floats

_FOLLOWED = 3  # starts that are followed beyond the first two sweeps


def search_start(
    sweeps: Sequence[PreparedSweep], guesses: Sequence[Floats], config: LidarOdometryConfig
) -> Floats | None:
    """Return the (6,) velocity of the car at the first sweep; None where nothing makes the first two agree.

    Args:
        sweeps: The first sweeps, at least two.
        guesses: (6,) velocities that are tried beside those that a search finds, and that of a car that stands.
        config: The method's settings.
    """
    if min(len(sweep.source) for sweep in sweeps[:2]) < MIN_POINTS:
        return None
    seconds = sweeps[1].time_s - sweeps[0].time_s
    search = config.search
    reach = Reach(search.max_speed_mps * seconds, search.max_turn_radps * seconds)
    motions = search_motion(sweeps[0].structure.xyz_m, sweeps[1].structure.xyz_m, np.eye(4), reach, search)
    starts = [np.zeros(6), *guesses, *(velocity_between(np.eye(4), motion, seconds) for motion in motions)]
    tracks: list[tuple[float, Tracker]] = []
    velocities: list[Floats] = []
    for start in starts:
        tracker = Tracker(sweeps[0], np.eye(4), start, config)
        first = tracker.follow(sweeps[1])
        if first.agreement is None or not is_believed(first.agreement, config):
            continue
        if any(_is_same(first.twist * seconds, known * seconds, search) for known in velocities):
            continue
        speed = float(np.linalg.norm(first.twist[:3])) / search.max_speed_mps
        error_m2 = first.agreement.error_m2(config.agreement.partner_m)
        tracks.append((error_m2 * (1 + search.preference * speed), tracker))
        velocities.append(first.twist)
    order = sorted(range(len(tracks)), key=lambda number: tracks[number][0])[:_FOLLOWED]
    # Alone it would win anyway.
    errors = [_follow(*tracks[number], sweeps[2:], config) if len(order) > 1 else 0.0 for number in order]
    return velocities[order[int(np.argmin(errors))]] if order else None


def _follow(
    first_m2: float, tracker: Tracker, sweeps: Sequence[PreparedSweep], config: LidarOdometryConfig
) -> float:
    """Return the mean error of sweeps that are followed by the predicted motion; the first pair's is known."""
    errors = [first_m2]
    for sweep in sweeps:
        agreement = tracker.follow(sweep).agreement
        if agreement is not None:
            errors.append(agreement.error_m2(config.agreement.partner_m))
    return float(np.mean(errors))


def _is_same(motion: Floats, other: Floats, search: SearchConfig) -> bool:
    """Whether two (6,) motions, m and rad, ended at the same place."""
    is_near = np.linalg.norm(motion[:3] - other[:3]) < search.apart_m / 4
    return bool(is_near and np.linalg.norm(motion[3:] - other[3:]) < search.yaw_step_rad)
