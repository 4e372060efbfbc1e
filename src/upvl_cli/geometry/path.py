"""Where the car is between its frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.types import Array


def pose_at(times_ns: Sequence[int], poses: Array, time_ns: int) -> Array:
    """(4, 4) world_from_ego at any time: on the way between two frames, or on from the first or last two.

    Args:
        times_ns: (T,) times of the frames, ascending.
        poses: (T, 4, 4) world_from_ego of each; one alone is the pose at all times.
        time_ns: The time.
    """
    if len(poses) < 2:
        return np.asarray(poses[0])
    first = int(np.clip(np.searchsorted(times_ns, time_ns) - 1, 0, len(poses) - 2))
    step = compose(inverse(poses[first]), poses[first + 1])
    part = (time_ns - times_ns[first]) / (times_ns[first + 1] - times_ns[first])
    moved = np.eye(4)
    moved[:3, :3] = Rotation.from_rotvec(part * Rotation.from_matrix(step[:3, :3]).as_rotvec()).as_matrix()
    moved[:3, 3] = part * step[:3, 3]
    return compose(poses[first], moved)
