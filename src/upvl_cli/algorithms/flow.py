"""PROVISIONAL stand-in by the lead, so that the stages run: overwrite it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.algorithms.clustering import dbscan_voxels
from upvl_cli.algorithms.registration import align_yaw
from upvl_cli.types import Floats


def estimate(source_xyz_m: Floats, target_xyz_m: Floats, dt_s: float, *, max_speed_mps: float) -> Floats:
    """(n, 3) velocity of each source point."""
    both = np.concatenate([source_xyz_m, target_xyz_m])
    label = dbscan_voxels(both, eps_m=0.8, min_points=10, voxel_m=0.2)
    of_source, of_target = label[: len(source_xyz_m)], label[len(source_xyz_m) :]
    velocity = np.zeros((len(source_xyz_m), 3))
    for one in range(label.max(initial=-1) + 1):
        a, b = source_xyz_m[of_source == one][::3], target_xyz_m[of_target == one]
        if len(a) < 5 or len(b) < 5:
            continue
        tree = cKDTree(b)
        still = np.minimum(tree.query(a)[0], 1.0).mean()
        if still < 0.1:
            continue
        start = np.eye(4)
        start[:2, 3] = (b.mean(axis=0) - a.mean(axis=0))[:2]
        best = align_yaw(a, b, start=start, radius_m=1.0, iterations=20, stop_m=1e-3)
        motion = best[0] if isinstance(best, tuple) else best.target_from_source
        moved = a @ motion[:3, :3].T + motion[:3, 3]
        if np.minimum(tree.query(moved)[0], 1.0).mean() > 0.6 * still:
            continue
        mine = of_source == one
        v = (source_xyz_m[mine] @ motion[:3, :3].T + motion[:3, 3] - source_xyz_m[mine]) / dt_s
        if np.linalg.norm(v, axis=1).max() < max_speed_mps:
            velocity[mine] = v
    return velocity
