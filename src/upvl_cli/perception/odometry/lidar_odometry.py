"""LiDAR odometry: the pose of the car at each sweep, from the sweeps alone, by KISS-ICP."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from upvl_cli.perception.odometry.config import KissIcpConfig
from upvl_cli.types import Array, Floats

if TYPE_CHECKING:
    from kiss_icp.config import KISSConfig


def estimate_poses(sweeps: Iterable[Floats], config: KissIcpConfig) -> Array:
    """Estimate (T, 4, 4) world_from_ego of each sweep; the first sweep's axes are the world's.

    KISS-ICP (Vizzo et al., "In Defense of Point-to-Point ICP", RA-L 2023), without motion compensation: the
    sweeps are taken as they are. It predicts that the car stands at first, so that the first step of a moving
    car comes out too short: so it is run twice over the first sweeps, the second time with the speed found.

    Args:
        sweeps: (n, 3) points of each sweep in ego axes, in order of time.
        config: The method's settings.
    """
    from kiss_icp.config import KISSConfig

    kiss = KISSConfig()
    kiss.data.deskew = False
    kiss.data.min_range = config.min_range_m
    kiss.data.max_range = config.max_range_m
    kiss.mapping.voxel_size = config.voxel_m
    # One thread: sums over several come in another order each time, and with them other last digits.
    kiss.registration.max_num_threads = 1
    rest = iter(sweeps)
    first = list(islice(rest, config.warm_up_sweeps))
    warm = _register(first, kiss, np.eye(4))
    step = np.linalg.inv(warm[-2]) @ warm[-1] if len(warm) > 1 else np.eye(4)
    kiss.adaptive_threshold.initial_threshold = config.initial_threshold_m
    return _register((sweep for part in (first, rest) for sweep in part), kiss, step)


def _register(sweeps: Iterable[Floats], kiss: KISSConfig, step: Array) -> Array:
    """Return the pose of each sweep, where `step` is the motion that is predicted after the first sweep."""
    from kiss_icp.kiss_icp import KissICP

    filter_ = KissICP(kiss)
    poses: list[Array] = []
    for sweep in sweeps:
        filter_.register_frame(np.asarray(sweep, dtype=np.float64), np.zeros(0))
        if not poses:
            filter_.last_delta = step
        poses.append(filter_.last_pose.copy())
    return np.array(poses).reshape(-1, 4, 4)
