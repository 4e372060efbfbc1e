"""Masks over points: what moves, and what is background (UP-VL, Algorithm 1, lines 4 and 5)."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Bools, Floats, Ints

UNKNOWN = -1


def moving(velocity_mps: Floats, *, min_speed_mps: float) -> Bools:
    """(n,) whether each point moves: M_sf = |F_sf| >= eps_sf.

    Args:
        velocity_mps: (n, 3) velocity over the ground.
        min_speed_mps: eps_sf; the paper takes 1.0 for moving objects and 0 for all motion states.
    """
    # As float32: half precision rounds 1.0 m/s along two axes to either side of the threshold.
    return np.asarray(np.linalg.norm(velocity_mps.astype(np.float32), axis=1) >= min_speed_mps)


def unknown_background(points: int) -> Ints:
    """(n,) int8 of `UNKNOWN`: what a point is without a vision-language feature."""
    return np.full(points, UNKNOWN, dtype=np.int8)
