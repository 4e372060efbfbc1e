"""Motion compensation: KITTI's raw sweeps hold each point where the car saw it while the LiDAR turned.

The LiDAR turns clockwise and looks forward at the frame's time, so a point at an azimuth of a (from x to
y) was seen a / 2 pi of a turn before it. Source: the notes on `velodyne_points` in the development kit of
the raw data; a test shows that sweeps of drive 0001 fit each other best this way round.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from upvl_cli.geometry.se3 import compose
from upvl_cli.types import Array

# The Velodyne HDL-64E turns 5 to 20 times a second; other times between sweeps are not one turn.
_TURN_S = (0.05, 0.2)


def turn_s(time_ns: Mapping[int, int]) -> float:
    """Seconds that one turn takes, from the times of neighbouring frame numbers; 0 where unknown.

    Args:
        time_ns: Time of each frame number.
    """
    steps_ns = np.array([time_ns[frame + 1] - time_ns[frame] for frame in time_ns if frame + 1 in time_ns])
    steps_ns = steps_ns[steps_ns > 0]  # times without a sweep may be wrong: nobody needs them
    if not len(steps_ns):
        return 0.0
    # Times can be rounded to 10 ms, so the mean; but without the steps over turns that were lost.
    seconds = float(steps_ns[steps_ns < 1.5 * np.median(steps_ns)].mean()) / 1e9
    return seconds if _TURN_S[0] <= seconds <= _TURN_S[1] else 0.0


def offsets_s(xyz_ego_m: Array, *, turn_s: float) -> Array:
    """How long after the frame's time each place was seen, (n,) seconds.

    Args:
        xyz_ego_m: (n, 3) places in ego axes.
        turn_s: Seconds of one turn.
    """
    return -np.arctan2(xyz_ego_m[:, 1], xyz_ego_m[:, 0]) / (2 * np.pi) * turn_s


def twists(time_ns: Array, world_from_ego: Array) -> Array:
    """Velocity (m/s) and turn rate (rad/s) of the car at each frame, along its axes.

    Args:
        time_ns: (T,) ascending times.
        world_from_ego: (T, 4, 4) poses.

    Returns:
        (T, 6) float64: the slope of the parabola through the frames before and after; 0 for a single frame.
    """
    if len(time_ns) < 2:
        return np.zeros((len(time_ns), 6))
    steps_s = np.diff(time_ns) / 1e9
    moved = compose(np.linalg.inv(world_from_ego[:-1]), world_from_ego[1:])
    # The skew part of a small rotation is its axis times its angle.
    turned = np.stack([(moved[:, i, j] - moved[:, j, i]) / 2 for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    # Half the turn back: the way of a screw motion in the axes of both ends alike, not of the first one.
    way = moved[:, :3, 3] - np.cross(turned, moved[:, :3, 3]) / 2
    between = np.hstack([way, turned]) / steps_s[:, None]
    before, after = np.vstack([between[:1], between]), np.vstack([between, between[-1:]])
    before_s, after_s = np.append(steps_s[:1], steps_s)[:, None], np.append(steps_s, steps_s[-1:])[:, None]
    return np.asarray((before * after_s + after * before_s) / (before_s + after_s))


def untwist(xyz_ego_m: Array, twist: Array, offset_s: Array) -> Array:
    """Where the places lie from where the car stood at the frame's time.

    Args:
        xyz_ego_m: (n, 3) places as the turning LiDAR saw them.
        twist: (6,) velocity and turn rate of the car along its axes.
        offset_s: (n,) how long after the frame's time each place was seen.

    Returns:
        (n, 3) in the precision of the places; to first order, which is 2 cm at 50 m in a turn of 0.5 rad/s.
    """
    xyz = np.asarray(xyz_ego_m)
    rate_x, rate_y, rate_z = twist[3:]
    skew = np.array([[0, -rate_z, rate_y], [rate_z, 0, -rate_x], [-rate_y, rate_x, 0]])
    velocity = xyz @ skew.T.astype(xyz.dtype) + twist[:3].astype(xyz.dtype)
    return np.asarray(xyz + offset_s[:, None] * velocity)
