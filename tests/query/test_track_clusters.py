"""Clusters by average linkage, the plain way and with groups first."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage

from upvl_cli.query.clusters import agglomerate, cluster, group_near, neighbor_distances


def kinds(count: list[int], noise: float = 0.02, dim: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of length 1 around axes, and the axis of each, in a mixed order."""
    rng = np.random.default_rng(0)
    kind = rng.permutation(np.repeat(np.arange(len(count)), count))
    vectors = np.eye(dim)[kind] + rng.normal(0, noise, (len(kind), dim))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32), kind


def same_parts(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether two numberings part the items alike."""
    pairs = len(np.unique(np.stack([first, second], axis=1), axis=0))
    return pairs == len(np.unique(first)) == len(np.unique(second))


def test_clusters_are_those_of_average_linkage() -> None:
    rng = np.random.default_rng(1)
    vectors = rng.normal(size=(60, 5))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    merged = linkage(vectors, "average", metric="cosine")
    for distance in (0.1, 0.4, 0.7):
        plain = fcluster(merged, distance, "distance")
        assert same_parts(cluster(vectors, distance, max_groups=100), plain)
    assert same_parts(cluster(vectors, 0, max_groups=100, clusters=7), fcluster(merged, 7, "maxclust"))


def test_groups_first_give_the_same_clusters() -> None:
    vectors, kind = kinds([500, 300, 100, 3])
    plain = cluster(vectors, 0.3, max_groups=1000)
    fast = cluster(vectors, 0.3, max_groups=20)
    assert same_parts(plain, kind)
    np.testing.assert_array_equal(fast, plain)


def test_neighbours_are_those_of_the_plain_way() -> None:
    vectors, _ = kinds([40, 30])
    distance = 1 - vectors.astype(float) @ vectors.T + 9 * np.eye(70)
    np.testing.assert_allclose(neighbor_distances(vectors), distance.min(axis=1), atol=1e-6)
    many, _ = kinds([2500])
    assert len(neighbor_distances(many)) == 1000
    assert [len(neighbor_distances(vectors[:total])) for total in (0, 1, 2)] == [0, 0, 2]


def test_what_is_rare_has_a_group_of_its_own() -> None:
    """One among five thousand, and hardly more groups than kinds."""
    vectors, kind = kinds([5000, 1])
    group = group_near(vectors, 4)
    assert (group == group[kind == 1]).sum() == 1


def test_the_largest_cluster_is_the_first() -> None:
    vectors, kind = kinds([2, 9, 5])
    number = cluster(vectors, 0.3, max_groups=100)
    assert number[kind == 1].tolist() == [0] * 9
    assert number[kind == 2].tolist() == [1] * 5


def test_sizes_weigh_in_a_mean_distance() -> None:
    """Nine at 0 degrees and one at 30 are .134 apart; from one at 75 their mean is .696 away, unweighted .517."""
    angle = np.deg2rad([0, 30, 75])
    count = np.array([9, 1, 1])
    sums = np.column_stack([np.cos(angle), np.sin(angle)]) * count[:, None]
    assert agglomerate(sums, count, 0.13, None).tolist() == [0, 1, 2]
    assert agglomerate(sums, count, 0.69, None).tolist() == [0, 0, 1]
    assert agglomerate(sums, count, 0.70, None).tolist() == [0, 0, 0]


@pytest.mark.parametrize("total", [0, 1, 2])
def test_few_vectors(total: int) -> None:
    vectors = np.eye(3, dtype=np.float32)[:total]
    assert cluster(vectors, 0.5, max_groups=2).tolist() == list(range(total))
    assert cluster(vectors, 0.5, max_groups=2, clusters=5).tolist() == list(range(total))


def test_equal_vectors_are_one_cluster() -> None:
    vectors = np.tile(np.eye(2, dtype=np.float32)[:1], (9, 1))
    assert not cluster(vectors, 0.0, max_groups=100).any()
    assert not cluster(vectors, 1e-6, max_groups=3).any()
