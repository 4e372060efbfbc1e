"""Shape of the points of one object in one frame: what tells a car from a bush, a wall or a slope.

How many points there are, how dense they lie and how far away say more of the sensor than of the object: left out.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.amodal.edges import trimmed_extent
from upvl_cli.perception.objectness.config import ObjectnessConfig
from upvl_cli.types import Array, Floats

SHAPE_FEATURES = (
    "top_across_m",
    "top_along_m",
    "seen_length",
    "seen_width",
    "seen_height_m",
    "vertical_gap_m",
    "lowest_m",
    "linearity",
    "planarity",
    "scatter",
    "alignment",
    "depth_m",
    "ring_ratio",
)
_TRIM = 0.02
MIN_POINTS = 5  # fewer have no shape


def frame_shape(
    xyz_m: Floats, height_m: Floats, size_lwh_m: Floats, ring_points: int, config: ObjectnessConfig
) -> Array:
    """Return (f,) `SHAPE_FEATURES` of one frame; NaN where there are too few points for one.

    Args:
        xyz_m: (n, 3) points about the center of the box, x along its heading; n >= `MIN_POINTS`.
        height_m: (n,) their heights over the ground.
        size_lwh_m: (3,) size of the whole box.
        ring_points: Other points around the box.
        config: Settings.
    """
    top = xyz_m[height_m >= height_m.max() - config.top_share * np.ptp(height_m)]
    extent_m = trimmed_extent(xyz_m[:, :2], _TRIM)
    top_m = trimmed_extent(top[:, :2], _TRIM)
    half_m = size_lwh_m[:2] / 2
    depth_m = np.minimum(*(half_m - np.abs(xyz_m[:, :2])).T)
    return np.array(
        [
            top_m[1],
            top_m[0],
            *(extent_m / size_lwh_m[:2]),
            height_m.max(),
            np.diff(np.sort(height_m)).max(),
            height_m.min(),
            *_neighborhoods(xyz_m, config),
            np.median(np.maximum(depth_m, 0.0)),
            ring_points / len(xyz_m),
        ]
    )


def _neighborhoods(xyz_m: Floats, config: ObjectnessConfig) -> Array:
    """Return (4,) medians of linearity, planarity and scatter, and how well planes lie along the axes of the box.

    From the eigenvalues of each neighborhood (Demantke et al., Dimensionality based scale selection in 3D lidar
    point clouds, 2011).
    """
    if len(xyz_m) <= config.neighbors:
        return np.full(4, np.nan)
    sample = xyz_m[:: -(-len(xyz_m) // config.max_points)]
    _, near = cKDTree(xyz_m).query(sample, k=config.neighbors)
    patch = xyz_m[near] - xyz_m[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch) / config.neighbors)
    deviation = np.sqrt(np.maximum(values, 1e-12))
    low, middle, high = deviation.T
    linearity, planarity, scatter = (high - middle) / high, (middle - low) / high, low / high
    alignment = np.abs(vectors[:, :, 0]).max(axis=1)  # of the normal with the nearest axis of the box
    weight = planarity + 1e-9
    return np.array(
        [
            np.median(linearity),
            np.median(planarity),
            np.median(scatter),
            np.average(alignment, weights=weight),
        ]
    )
