"""Smoothing of a path: local regression of the positions over time."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.odometry.config import PathSmoothingConfig
from upvl_cli.types import Array, Bools, Floats


def smooth_path(
    world_from_ego: Floats, time_s: Floats, is_placed: Bools, config: PathSmoothingConfig
) -> Array:
    """Smooth the positions of (T, 4, 4) poses by a polynomial through their neighbors in time; rotations stay.

    A car's path is smooth, while each measured step is centimetres off, be it from a navigation unit
    whose clock is not the sweeps' or from odometry; and 3 cm a step look like 0.3 m/s of everything.
    Local regression by Cleveland, JASA 1979, without weights. A position with too few neighbors stays.

    Args:
        world_from_ego: (T, 4, 4) poses.
        time_s: (T,) their times, ascending.
        is_placed: (T,) which of them were measured; only these decide on their neighbors.
        config: Window and degree.
    """
    poses = np.array(world_from_ego, dtype=np.float64)
    if config.method == "none":
        return poses
    reach_s = config.half_window_s
    first = np.searchsorted(time_s, time_s - reach_s, side="left")
    last = np.searchsorted(time_s, time_s + reach_s, side="right")
    for step in range(len(poses)):
        near = first[step] + np.flatnonzero(is_placed[first[step] : last[step]])
        if len(near) > config.degree + 1:
            ahead = (time_s[near] - time_s[step]) / reach_s
            powers = np.vander(ahead, config.degree + 1, increasing=True)
            poses[step, :3, 3] = np.linalg.lstsq(powers, world_from_ego[near, :3, 3], rcond=None)[0][0]
    return poses
