"""Motion compensation: points that were measured while the LiDAR turned, moved to the frame's time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.types import Array, Floats

_SMALL_RAD = 1e-9  # below, sin(a) / a is 1 in every digit


def compensate(
    xyz_m: Array, offset_ns: Array, step: int, times_ns: Sequence[int], world_from_ego: Array
) -> Floats:
    """Return (n, 3) static places as seen from where the car stood at the frame's time, float64.

    Between two frames the car moves as a screw at constant speed, and beyond the first and last as between the
    two before.

    Args:
        xyz_m: (n, 3) points, each in the ego axes of the moment at which it was measured.
        offset_ns: (n,) when each was measured, after the frame's time.
        step: Number of the frame in the drive, from 0.
        times_ns: (T,) times of the frames, ascending.
        world_from_ego: (T, 4, 4) poses of the frames.
    """
    xyz = np.array(xyz_m, dtype=np.float64).reshape(-1, 3)
    if len(times_ns) < 2:
        return xyz
    offset_ns = np.asarray(offset_ns, dtype=np.float64)
    for later in (False, True):
        other = step + 1 if later else step - 1
        if not 0 <= other < len(times_ns):
            other = 2 * step - other  # on as between the neighbors on the other side
        moving = np.flatnonzero(offset_ns > 0 if later else offset_ns < 0)
        motion = compose(inverse(world_from_ego[step]), world_from_ego[other])
        share = offset_ns[moving] / (times_ns[other] - times_ns[step])
        xyz[moving] = _move(motion, share, xyz[moving])
    return xyz


def _move(motion: Array, share: Floats, xyz: Floats) -> Floats:
    """Return (n, 3) points under a part of a motion: its rotation vector and its translation times `share`."""
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    angle = float(np.linalg.norm(turn))
    translation = share[:, None] * motion[:3, 3]
    if angle < _SMALL_RAD:
        return np.asarray(xyz + translation)
    axis = turn / angle
    # Rodrigues' formula: v + sin(a) (axis x v) + (1 - cos(a)) (axis x (axis x v)).
    across = np.cross(axis, xyz)
    twice = np.cross(axis, across)
    sin, cos = np.sin(share * angle)[:, None], np.cos(share * angle)[:, None]
    return np.asarray(xyz + sin * across + (1 - cos) * twice + translation)
