"""Smoothing of a path: local regression of the positions over time."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.odometry.config import PathSmoothingConfig
from upvl_cli.types import Array, Floats, Ints


def smooth_path(world_from_ego: Floats, frame: Ints, config: PathSmoothingConfig) -> Array:
    """Smooth the positions of (T, 4, 4) poses by a polynomial through their neighbors; rotations stay.

    A car's path is smooth, while each measured step is centimetres off, be it from a navigation unit
    whose clock is not the sweeps' or from odometry; and 3 cm a step look like 0.3 m/s of everything.
    Local regression by Cleveland, JASA 1979, without weights. A position with too few neighbors stays.

    Args:
        world_from_ego: (T, 4, 4) poses.
        frame: (T,) number of each frame; frames are evenly spaced in time, and numbers may be missing.
        config: Window, as a difference of numbers, and degree.
    """
    poses = np.array(world_from_ego, dtype=np.float64)
    if config.method == "none":
        return poses
    for step, number in enumerate(frame):
        near = np.flatnonzero(np.abs(frame - number) <= config.half_window_frames)
        if len(near) > config.degree + 1:
            powers = np.vander((frame[near] - number).astype(np.float64), config.degree + 1, increasing=True)
            poses[step, :3, 3] = np.linalg.lstsq(powers, world_from_ego[near, :3, 3], rcond=None)[0][0]
    return poses
