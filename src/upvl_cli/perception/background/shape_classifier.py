"""Background state of points by their LiDAR shape.

The points that a camera saw are the training set: background is told by its height above the ground and by how its
surface runs, without color. All other points are classified by it (an addition to UP-VL, which keeps a point
without a feature; the idea is that of its detector, which is distilled from the cameras into LiDAR).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.background.config import ShapeClassifierConfig
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Array, Floats, Ints

FEATURES = 8
_MIN_VARIANCE_M2 = 1e-6  # 1 mm: a point or a perfect plane has no smaller extent


class ShapeFeatures(NamedTuple):
    """Shape of the surroundings of the points of a sweep, a voxel at a time.

    Attributes:
        voxel_of_point: (n,) number of the voxel of each point.
        feature: (m, 8) float32 of each voxel: height above the ground, linearity, planarity and scattering of its
            neighborhood, verticality of its normal, highest and lowest height around it, and the logarithm of
            the number of voxels near.
    """

    voxel_of_point: Ints
    feature: Floats


def compute_shape_features(xyz_m: Floats, height_m: Floats, config: ShapeClassifierConfig) -> ShapeFeatures:
    """Return the shape of the surroundings of each point.

    Linearity, planarity and scattering are those of Demantke et al., "Dimensionality based scale selection in 3D
    lidar point clouds", ISPRS 2011, from the standard deviations s1 >= s2 >= s3 along the principal axes:
    (s1 - s2) / s1, (s2 - s3) / s1 and s3 / s1.

    Args:
        xyz_m: (n, 3) points of one sweep that are above the ground.
        height_m: (n,) their heights above the ground.
        config: Sizes of voxels and neighborhoods.
    """
    voxels = voxelize(xyz_m.reshape(-1, 3), voxel_m=config.voxel_m)
    total = len(voxels.weight)
    if not total:
        return ShapeFeatures(voxels.of_point, np.zeros((0, FEATURES), dtype=np.float32))
    height = np.bincount(voxels.of_point, height_m, total) / voxels.weight
    near, deviation, verticality = _local_surfaces(voxels.centroid, config.surface_radius_m)
    low, high = _column_heights(voxels.centroid[:, :2], height, config)
    longest = deviation[:, 2]
    linearity = (longest - deviation[:, 1]) / longest
    planarity = (deviation[:, 1] - deviation[:, 0]) / longest
    scattering = deviation[:, 0] / longest
    columns = (height, linearity, planarity, scattering, verticality, high, low, np.log(near))
    return ShapeFeatures(voxels.of_point, np.stack(columns, axis=1).astype(np.float32))


def _local_surfaces(xyz_m: Floats, radius_m: float) -> tuple[Ints, Floats, Floats]:
    """Return the principal axes of the neighborhood of each voxel.

    Args:
        xyz_m: (m, 3) voxels.
        radius_m: Radius of a neighborhood.

    Returns:
        (m,) number of voxels near, (m, 3) standard deviations along the principal axes, ascending, and (m,) the
        vertical part of the normal, 0 to 1.
    """
    total = len(xyz_m)
    left, right = _neighbor_pairs(xyz_m, radius_m)
    near = np.bincount(left, minlength=total)

    def mean(values: Floats) -> Floats:
        return np.bincount(left, values, total) / near

    apart = xyz_m[right] - xyz_m[left]
    center = [mean(apart[:, axis]) for axis in range(3)]
    covariance = np.empty((total, 3, 3))
    for a in range(3):
        for b in range(a + 1):
            covariance[:, a, b] = covariance[:, b, a] = (
                mean(apart[:, a] * apart[:, b]) - center[a] * center[b]
            )
    values, axes = np.linalg.eigh(covariance)
    return near, np.sqrt(np.maximum(values, _MIN_VARIANCE_M2)), np.abs(axes[:, 2, 0])


def _column_heights(xy_m: Floats, height_m: Floats, config: ShapeClassifierConfig) -> tuple[Floats, Floats]:
    """Return (m,) lowest and (m,) highest height in the columns around each voxel."""
    columns = voxelize(xy_m, voxel_m=config.column_m)
    left, right = _neighbor_pairs(columns.centroid, config.column_radius_m)
    low, high = np.full(len(columns.weight), np.inf), np.full(len(columns.weight), -np.inf)
    np.minimum.at(low, columns.of_point, height_m)
    np.maximum.at(high, columns.of_point, height_m)
    around_low, around_high = low.copy(), high.copy()
    np.minimum.at(around_low, left, low[right])
    np.maximum.at(around_high, left, high[right])
    return around_low[columns.of_point], around_high[columns.of_point]


def _neighbor_pairs(points: Floats, radius_m: float) -> tuple[Ints, Ints]:
    """Return all ordered pairs of points within a radius, each point with itself among them."""
    first, second = cKDTree(points).query_pairs(radius_m, output_type="ndarray").T
    itself = np.arange(len(points))
    return np.concatenate([first, second, itself]), np.concatenate([second, first, itself])


class ShapeClassifier:
    """Gradient-boosted trees that tell background by shape, trained on the points that a camera saw."""

    def __init__(self, samples: Sequence[tuple[Floats, Ints]], config: ShapeClassifierConfig) -> None:
        """Train the trees; with too few samples of either state none are.

        Args:
            samples: `training_samples` of each sweep of a drive.
            config: Number of samples and of trees.
        """
        from sklearn.ensemble import HistGradientBoostingClassifier

        step = max(1, -(-sum(len(state) for _, state in samples) // config.max_samples))
        chosen: list[tuple[Floats, Ints]] = [(np.zeros((0, FEATURES), np.float32), np.zeros(0, np.int8))]
        skipped = 0  # samples of a sweep before the first that is chosen
        for part, part_state in samples:
            chosen.append((part[skipped::step], part_state[skipped::step]))
            skipped = (skipped - len(part_state)) % step
        feature, state = (np.concatenate(parts) for parts in zip(*chosen, strict=True))
        self._trees = None
        if np.bincount(state, minlength=2).min() >= config.min_samples_per_class:
            trees = HistGradientBoostingClassifier(
                max_iter=config.iterations, early_stopping=False, random_state=0
            )
            self._trees = trees.fit(feature, state)

    def classify(self, sweep: ShapeFeatures) -> Array:
        """Return (n,) int8: 1 where a point looks like background, 0 where not, `UNKNOWN` where untrained."""
        if self._trees is None or not len(sweep.feature):
            return np.full(len(sweep.voxel_of_point), UNKNOWN, dtype=np.int8)
        return np.asarray(self._trees.predict(sweep.feature), dtype=np.int8)[sweep.voxel_of_point]


def training_samples(
    sweep: ShapeFeatures, background: Ints, config: ShapeClassifierConfig
) -> tuple[Floats, Ints]:
    """Return (k, 8) features of the voxels with a known state, and (k,) whether each is background.

    Args:
        sweep: Shape of the sweep.
        background: (n,) 1 where a camera saw background, 0 where not, `UNKNOWN` where none looked.
        config: When a voxel is background.
    """
    total = len(sweep.feature)
    known = background != UNKNOWN
    count = np.bincount(sweep.voxel_of_point[known], minlength=total)
    share = np.bincount(sweep.voxel_of_point[known], background[known], total) / np.maximum(count, 1)
    is_background = share[count > 0] >= config.min_background_share
    return sweep.feature[count > 0], is_background.astype(np.int8)
