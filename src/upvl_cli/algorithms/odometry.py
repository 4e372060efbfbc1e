"""Where the car is, from its sweeps alone."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from upvl_cli.types import Array, Floats


def odometry(sweeps: Iterable[Floats], *, voxel_m: float, min_range_m: float, max_range_m: float) -> Array:
    """(T, 4, 4) world_from_ego of each sweep; the first sweep's axes are the world's.

    KISS-ICP (Vizzo et al., "In Defense of Point-to-Point ICP", RA-L 2023), without motion
    compensation: the sweeps are taken as they are.

    Args:
        sweeps: (n, 3) points of each sweep in ego axes, in order of time.
        voxel_m: Edge of the voxels of the local map.
        min_range_m: Nearer points are left out.
        max_range_m: Farther points are left out.
    """
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.deskew = False
    config.data.min_range = min_range_m
    config.data.max_range = max_range_m
    config.mapping.voxel_size = voxel_m
    # One thread: sums over several come in another order each time, and with them other last digits.
    config.registration.max_num_threads = 1
    filter_ = KissICP(config)
    poses = []
    for sweep in sweeps:
        filter_.register_frame(np.asarray(sweep, dtype=np.float64), np.zeros(0))
        poses.append(filter_.last_pose.copy())
    return np.array(poses).reshape(-1, 4, 4)
