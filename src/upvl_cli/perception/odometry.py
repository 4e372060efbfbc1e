"""Where the car is, from its sweeps alone; and its path without jitter."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import Any

import numpy as np

from upvl_cli.types import Array, Floats, Ints

WARM_UP = 4  # sweeps from which the speed at the start is known
# How far off the first guess may be, metres; kiss-icp's own 2 m let a first step of 0.99 m end at 0.96.
FIRST_DEVIATION_M = 0.5
DEGREE = 2  # within a second a car's path is a parabola


def odometry(sweeps: Iterable[Floats], *, voxel_m: float, min_range_m: float, max_range_m: float) -> Array:
    """(T, 4, 4) world_from_ego of each sweep; the first sweep's axes are the world's.

    KISS-ICP (Vizzo et al., "In Defense of Point-to-Point ICP", RA-L 2023), without motion
    compensation: the sweeps are taken as they are. It takes the car to stand at first, so that the
    first step of a moving car comes out too short: here it starts over with the speed it has found.

    Args:
        sweeps: (n, 3) points of each sweep in ego axes, in order of time.
        voxel_m: Edge of the voxels of the local map.
        min_range_m: Nearer points are left out.
        max_range_m: Farther points are left out.
    """
    from kiss_icp.config import KISSConfig

    config = KISSConfig()
    config.data.deskew = False
    config.data.min_range = min_range_m
    config.data.max_range = max_range_m
    config.mapping.voxel_size = voxel_m
    # One thread: sums over several come in another order each time, and with them other last digits.
    config.registration.max_num_threads = 1
    rest = iter(sweeps)
    first = list(islice(rest, WARM_UP))
    warm = _registered(first, config, np.eye(4))
    step = np.linalg.inv(warm[-2]) @ warm[-1] if len(warm) > 1 else np.eye(4)
    config.adaptive_threshold.initial_threshold = FIRST_DEVIATION_M
    return _registered((sweep for part in (first, rest) for sweep in part), config, step)


def _registered(sweeps: Iterable[Floats], config: Any, step: Array) -> Array:
    """The pose of each sweep, where the car is taken to go on at `step` a sweep after the first."""
    from kiss_icp.kiss_icp import KissICP

    filter_ = KissICP(config)
    poses: list[Array] = []
    for sweep in sweeps:
        filter_.register_frame(np.asarray(sweep, dtype=np.float64), np.zeros(0))
        if not poses:
            filter_.last_delta = step
        poses.append(filter_.last_pose.copy())
    return np.array(poses).reshape(-1, 4, 4)


def smoothed(world_from_ego: Floats, *, at: Ints, reach: int) -> Array:
    """(T, 4, 4) poses whose places lie on the parabola through their neighbours; rotations stay.

    A car's path is smooth, while each measured step is centimetres off, be it from a navigation unit
    whose clock is not the sweeps' or from odometry; and 3 cm a step look like 0.3 m/s of everything.

    Args:
        world_from_ego: (T, 4, 4) poses.
        at: (T,) number of each frame; frames are evenly spaced in time, and numbers may be missing.
        reach: Neighbours on each side that take part, as a difference of numbers; 0 changes nothing.

    Local regression by Cleveland, JASA 1979, without weights.
    """
    poses = np.array(world_from_ego, dtype=np.float64)
    for step, number in enumerate(at):
        near = np.flatnonzero(np.abs(at - number) <= reach)
        if len(near) > DEGREE + 1:
            powers = np.vander((at[near] - number).astype(np.float64), DEGREE + 1, increasing=True)
            poses[step, :3, 3] = np.linalg.lstsq(powers, world_from_ego[near, :3, 3], rcond=None)[0][0]
    return poses
