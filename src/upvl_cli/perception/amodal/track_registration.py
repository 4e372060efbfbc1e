"""The sweeps of one object laid on each other, densest first and outward in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.registration.config import RegistrationConfig
from upvl_cli.perception.registration.icp import register_clouds
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Array, Floats

VOXEL_M = 0.1  # half of the usual radius: finer detail is noise of range and of motion during a sweep
MOST_POINTS = 300  # of a sweep take part: a rigid motion has four unknowns
STOP_M = 0.005
GOOD_SHARE = 0.8  # with this share of the points in place no other start is tried
SHIFTS = (-0.5, -0.25, 0.0, 0.25, 0.5)  # starts, in lengths and widths (MI-UP, section 4.3)
MAX_YAW_RAD = 0.3  # headings come from motion: a larger correction is a wrong match


def register(
    clouds_m: Sequence[Floats], *, min_points: int, radius_m: float, iterations: int, min_inlier_share: float
) -> list[Array | None]:
    """Rigid motions that lay the clouds of one object on its densest one, turning about the vertical only.

    Each next cloud is aligned with all that lie in place already, from where its neighbour in time went
    and from its own centre; where both fit badly, from 24 shifts more.

    Args:
        clouds_m: T clouds (n, 3), each in axes about its own centre and heading.
        min_points: A cloud with fewer points stays out.
        radius_m: Pairs further apart than this are left out.
        iterations: Most steps of each alignment.
        min_inlier_share: A cloud of which a smaller share finds its place stays out.

    Returns:
        T matrices (4, 4) to the axes of the densest cloud; None for those that stay out.
    """
    config = RegistrationConfig(
        radius_m, iterations, STOP_M, SHIFTS, GOOD_SHARE, min_inlier_share, MAX_YAW_RAD
    )
    found: list[Array | None] = [None] * len(clouds_m)
    thin = [voxelize(cloud, voxel_m=VOXEL_M).centroid.reshape(-1, 3) for cloud in clouds_m]
    densest = int(np.argmax([len(cloud) for cloud in thin])) if thin else 0
    if not thin or len(clouds_m[densest]) < min_points:
        return found
    found[densest] = np.eye(4)
    model, extent = thin[densest], np.ptp(thin[densest][:, :2], axis=0)
    for direction in (range(densest + 1, len(thin)), range(densest - 1, -1, -1)):
        nearest: Array = np.eye(4)
        for at in direction:
            if len(clouds_m[at]) < min_points:
                continue
            cloud = thin[at][:: -(-len(thin[at]) // MOST_POINTS)]
            best = register_clouds(cloud, model, (nearest, np.eye(4)), extent, config)
            if best is None:
                continue
            found[at] = nearest = best.target_from_source
            model = voxelize(np.vstack([model, apply(nearest, thin[at])]), voxel_m=VOXEL_M).centroid
    return found
