"""Voxel DBSCAN: the definition followed plainly, and scikit-learn's on the same voxels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import DBSCAN

from upvl_cli.perception.clustering import dbscan_voxels
from upvl_cli.perception.voxels import voxelize


def crowd(seed: int, blobs: int, stray: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-10, 10, (blobs, 3))
    return np.concatenate(
        [centre + rng.normal(0, 0.4, (30, 3)) for centre in centres] + [rng.uniform(-12, 12, (stray, 3))]
    )


def same_partition(left: np.ndarray, right: np.ndarray) -> bool:
    pairs = len(np.unique(np.stack([left, right]), axis=1).T)
    return pairs == len(np.unique(left)) == len(np.unique(right))


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(1, 60))
def test_core_voxels_fall_apart_as_sklearn_says(seed: int, blobs: int, stray: int) -> None:
    points = crowd(seed, blobs, stray)
    found = dbscan_voxels(points, eps_m=1.0, min_points=10, voxel_m=0.2)
    voxels = voxelize(points, voxel_m=0.2)
    reference = DBSCAN(eps=1.0, min_samples=10).fit(voxels.centroid, sample_weight=voxels.weight)
    np.testing.assert_array_equal(found == -1, reference.labels_[voxels.of_point] == -1)
    core = np.isin(voxels.of_point, reference.core_sample_indices_)
    assert same_partition(found[core], reference.labels_[voxels.of_point][core])


def test_labels_count_up_by_first_point() -> None:
    points = np.concatenate([np.full((5, 3), 9.0), np.zeros((5, 3)), [[50.0, 0, 0]]])
    labels = dbscan_voxels(points, eps_m=1.0, min_points=3, voxel_m=0.1)
    assert labels.tolist() == [0] * 5 + [1] * 5 + [-1]


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((1, 3))], ids=["none", "one"])
def test_too_few_points_are_noise(points: np.ndarray) -> None:
    labels = dbscan_voxels(points, eps_m=1.0, min_points=2, voxel_m=0.1)
    assert labels.tolist() == [-1] * len(points)


def test_a_rim_point_joins_the_nearest_core() -> None:
    x_m = np.repeat([-0.9, -0.5, 0.0, 0.9, 1.5, 2.0, 2.4], [4, 4, 4, 1, 4, 4, 4])
    points = np.stack([x_m, 0 * x_m, 0 * x_m], axis=1)
    labels = dbscan_voxels(points, eps_m=1.0, min_points=10, voxel_m=0.1)
    assert labels.tolist() == [0] * 12 + [1] * 13


def test_far_points_have_a_longer_reach_and_near_ones_keep_theirs() -> None:
    rows = np.repeat(np.arange(6.0), 2)  # 1 m apart
    points = np.concatenate([np.column_stack([rows + x, np.zeros((12, 2))]) for x in (5.0, 60.0)])
    reach_m = np.where(points[:, 0] > 30, 1.2, 0.6)
    found = dbscan_voxels(points, eps_m=0.6, min_points=3, voxel_m=0.1, reach_m=reach_m)
    assert (found[:12] == -1).all()
    assert (found[12:] == 0).all()
    everywhere = dbscan_voxels(points, eps_m=0.6, min_points=3, voxel_m=0.1, reach_m=np.full(24, 0.6))
    assert (everywhere == -1).all()


def test_a_pair_counts_once_though_it_lies_within_a_shorter_reach_too() -> None:
    # Three voxels of one point each, 20 m away, all with a long reach; a fourth far off has a short one.
    points = np.array([[20.0, 0.0, 0.0], [20.4, 0.0, 0.0], [20.8, 0.0, 0.0], [-50.0, 0.0, 0.0]])
    reach_m = np.array([1.2, 1.2, 1.2, 0.6])
    labels = [
        dbscan_voxels(points, eps_m=0.6, min_points=count, voxel_m=0.1, reach_m=reach_m).tolist()
        for count in (3, 4)
    ]
    assert labels == [[0, 0, 0, -1], [-1, -1, -1, -1]]
