"""Registration of the clouds of one object with each other, from the densest one outward in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.amodal.config import TrackRegistrationConfig
from upvl_cli.perception.registration.icp import register_clouds
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Array, Floats


def register_track(clouds_m: Sequence[Floats], config: TrackRegistrationConfig) -> dict[int, Array]:
    """Return the motions that take the clouds of one object to its densest one, turning about the vertical only.

    Each next cloud is aligned with all that are registered already, from the motion of its neighbor in time and
    from its own center; where both fit badly, from 24 shifts more (MI-UP, section 4.3).

    Args:
        clouds_m: T clouds (n, 3), each in axes about its own center and heading.
        config: Settings.

    Returns:
        (4, 4) motion to the axes of the densest cloud, for the number of each cloud that is registered.
    """
    thin = [voxelize(cloud, voxel_m=config.voxel_m).centroid.reshape(-1, 3) for cloud in clouds_m]
    densest = int(np.argmax([len(cloud) for cloud in thin])) if thin else 0
    if not config.enabled or not thin or len(clouds_m[densest]) < config.min_points:
        return {}
    motions: dict[int, Array] = {densest: np.eye(4)}
    model, extent_m = thin[densest], np.ptp(thin[densest][:, :2], axis=0)
    for direction in (range(densest + 1, len(thin)), range(densest - 1, -1, -1)):
        neighbor: Array = np.eye(4)
        for number in direction:
            if len(clouds_m[number]) < config.min_points:
                continue
            cloud = thin[number][:: -(-len(thin[number]) // config.max_points)]
            alignment = register_clouds(cloud, model, (neighbor, np.eye(4)), extent_m, config.icp)
            if alignment is None:
                continue
            motions[number] = neighbor = alignment.target_from_source
            moved = apply(neighbor, thin[number])
            model = voxelize(np.vstack([model, moved]), voxel_m=config.voxel_m).centroid
    return motions if len(motions) >= config.min_frames else {}
