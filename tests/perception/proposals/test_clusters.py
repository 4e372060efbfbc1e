"""Bookkeeping of cluster labels, on labels short enough to count by eye."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.proposals.clusters import (
    background_share,
    cluster_sizes,
    drop_clusters,
    flagged_share,
    median_velocities,
    points_of_clusters,
)

LABEL = np.array([1, -1, 0, 3, 1, 3, 3, -1])  # cluster 2 has no point
NONE = np.zeros(0, np.int64)


def test_points_and_sizes_of_clusters_without_noise_and_with_empty_ones() -> None:
    assert [points.tolist() for points in points_of_clusters(LABEL)] == [[2], [0, 4], [], [3, 5, 6]]
    assert cluster_sizes(LABEL).tolist() == [1, 2, 0, 3]
    assert list(points_of_clusters(NONE)) == []
    assert cluster_sizes(np.array([-1, -1])).tolist() == []


def test_share_of_flagged_points_is_that_of_each_clusters_own() -> None:
    flag = np.array([1, 1, 0, 1, 1, 0, 0, 1], bool)
    np.testing.assert_allclose(flagged_share(LABEL, flag), [0, 1, 0, 1 / 3])


def test_share_of_background_is_among_the_points_of_known_state() -> None:
    background = np.array([1, 1, -1, 1, 0, -1, -1, 1])
    np.testing.assert_allclose(background_share(LABEL, background), [0, 0.5, 0, 1])


def test_clusters_after_a_dropped_one_move_up_and_its_points_become_noise() -> None:
    label, dropped = drop_clusters(LABEL, np.array([False, True, True, False]))
    assert label.tolist() == [-1, -1, 0, 1, -1, 1, 1, -1]
    assert dropped == 2
    assert drop_clusters(NONE, np.zeros(0, bool))[0].tolist() == []


def test_the_velocity_of_a_cluster_is_the_median_of_its_points() -> None:
    velocity = np.array([[1.0, 0, 0], [2, 0, 0], [90, 5, 0], [7, 7, 7]])
    np.testing.assert_allclose(median_velocities(np.array([0, 0, 0, -1]), velocity), [[2, 0, 0]])
    assert median_velocities(NONE, np.zeros((0, 3))).shape == (0, 3)


def test_median_velocities_are_those_of_numpy() -> None:
    rng = np.random.default_rng(0)
    label, velocity = rng.permutation(np.repeat([-1, 0, 1, 2], [5, 1, 4, 7])), rng.normal(size=(17, 3))
    expected = [np.median(velocity[label == number], axis=0) for number in range(3)]
    np.testing.assert_array_equal(median_velocities(label, velocity), expected)
    assert median_velocities(np.array([-1]), np.zeros((1, 3))).shape == (0, 3)
