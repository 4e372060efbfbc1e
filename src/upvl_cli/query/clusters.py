"""Clusters of vectors of length 1 by average linkage; many vectors are grouped first."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Floats, Ints

_REFINEMENTS = 2  # of the groups: they need only be smaller than the clusters
_SAMPLE, _SAMPLE_ROWS = 1000, 100  # vectors whose neighbours are looked for, and how many at once
_ROWS = 2**14  # whose dot products with all groups are held at once


def cluster(vectors: Floats, max_distance: float, *, max_groups: int, clusters: int | None = None) -> Ints:
    """Return (n,) number of the cluster of each vector, the largest cluster first.

    Clusters whose members have the smallest mean cosine distance are merged (average linkage, UPGMA) as long as it is
    at most `max_distance`, or until there are as many `clusters` as asked for. Of more than `max_groups` vectors
    groups of near ones are merged instead of single ones.

    Args:
        vectors: (n, d) vectors of length 1.
        max_distance: Largest mean cosine distance between two clusters that are merged.
        max_groups: Number of groups.
        clusters: Number of clusters; None takes `max_distance`.
    """
    group = np.arange(len(vectors)) if len(vectors) <= max_groups else group_near(vectors, max_groups)
    sums, count = _sums(vectors, group)
    number = agglomerate(sums, count, max_distance, clusters)[group]
    sizes = np.bincount(number, minlength=1)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return np.asarray(rank[number])


def agglomerate(sums: Floats, count: Ints, max_distance: float, clusters: int | None) -> Ints:
    """Return (m,) number of the cluster of each of m groups, in the order of their first group.

    The mean cosine between the members of two groups is the dot product of their mean vectors.

    Args:
        sums: (m, d) sum of the vectors of each group.
        count: (m,) vectors in each group, at least one.
        max_distance: As in `cluster`.
        clusters: As in `cluster`.
    """
    total = len(sums)
    parent = np.arange(total)
    mean = np.asarray(sums, dtype=np.float64) / np.asarray(count)[:, None]
    weight = np.asarray(count, dtype=np.float64)
    cosine = mean @ mean.T
    np.fill_diagonal(cosine, -np.inf)
    for left in range(total, 1, -1):
        place = int(cosine.argmax())
        first, second = sorted(divmod(place, total))
        near_enough = 1 - cosine[first, second] <= max_distance
        if left <= clusters if clusters is not None else not near_enough:
            break
        parent[parent == second] = first
        # The mean cosine with any other group is the mean of both, by their sizes.
        share = weight[first] / (weight[first] + weight[second])
        merged = share * cosine[first] + (1 - share) * cosine[second]
        merged[first] = -np.inf
        cosine[first] = cosine[:, first] = merged
        cosine[second] = cosine[:, second] = -np.inf
        weight[first] += weight[second]
    return np.asarray(np.unique(parent, return_inverse=True)[1].reshape(-1))


def neighbor_distances(vectors: Floats) -> Floats:
    """Return (m,) cosine distances of vectors to the nearest other one; of many vectors a thousand are taken.

    Args:
        vectors: (n, d) vectors of length 1.
    """
    if len(vectors) < 2:
        return np.zeros(0)
    chosen = np.unique(np.linspace(0, len(vectors) - 1, min(len(vectors), _SAMPLE)).astype(np.int64))
    parts = []
    for begin in range(0, len(chosen), _SAMPLE_ROWS):
        rows = chosen[begin : begin + _SAMPLE_ROWS]
        cosine = vectors[rows] @ vectors.T
        cosine[np.arange(len(rows)), rows] = -np.inf
        parts.append(1 - cosine.max(axis=1))
    return np.asarray(np.maximum(np.concatenate(parts), 0))


def group_near(vectors: Floats, groups: int) -> Ints:
    """Return (n,) number of a group of near vectors for each, without gaps.

    The centres start as far from each other as can be (Gonzalez 1985), so that what is rare has a group of its own,
    and are then moved to the means of their groups (Lloyd).

    Args:
        vectors: (n, d) vectors of length 1.
        groups: Number of groups, less than n.
    """
    nearest = vectors @ vectors[0]
    centres = [0]
    while len(centres) < groups:
        centres.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, vectors @ vectors[centres[-1]])
    centre = vectors[centres]
    for _ in range(_REFINEMENTS):
        sums, _count = _sums(vectors, _nearest(vectors, centre))
        centre = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.unique(_nearest(vectors, centre), return_inverse=True)[1].reshape(-1))


def _nearest(vectors: Floats, centre: Floats) -> Ints:
    parts = [
        (vectors[begin : begin + _ROWS] @ centre.T).argmax(axis=1) for begin in range(0, len(vectors), _ROWS)
    ]
    return np.concatenate(parts)


def _sums(vectors: Floats, group: Ints) -> tuple[Floats, Ints]:
    """Return the sum and the number of the vectors of each group; groups without any are left out."""
    if not len(vectors):
        return np.zeros((0, vectors.shape[1])), np.zeros(0, np.int64)
    order = np.argsort(group, kind="stable")
    _, first, count = np.unique(group[order], return_index=True, return_counts=True)
    return np.add.reduceat(vectors[order].astype(np.float64), first, axis=0), count
