"""Cluster labels of points: -1 for noise, else the number of the cluster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.perception.clustering import NOISE
from upvl_cli.types import Array, Bools, Floats, Ints


def points_of_clusters(label: Ints) -> Sequence[Ints]:
    """Return the numbers of the points of each cluster, ascending.

    Args:
        label: (n,) cluster of each point, -1 for none.
    """
    order = np.argsort(label, kind="stable")
    first = np.searchsorted(label[order], np.arange(label.max(initial=NOISE) + 1))
    return np.split(order, first)[1:]


def cluster_sizes(label: Ints) -> Ints:
    """Return (k,) number of points of each cluster."""
    return np.bincount(label[label != NOISE], minlength=label.max(initial=NOISE) + 1)


def flagged_share(label: Ints, flag: Bools) -> Array:
    """Return (k,) share of the points of each cluster that carry a flag.

    Args:
        label: (n,) cluster of each point, -1 for none.
        flag: (n,) whether each point carries it.
    """
    hits = np.bincount(label[(label != NOISE) & flag], minlength=label.max(initial=NOISE) + 1)
    return hits / np.maximum(cluster_sizes(label), 1)


def background_share(label: Ints, background: Ints) -> Array:
    """Return (k,) share of background among the points of each cluster whose state is known, 0 without any.

    Args:
        label: (n,) cluster of each point, -1 for none.
        background: (n,) 1 background, 0 not, negative unknown.
    """
    known = (label != NOISE) & (background >= 0)
    total = label.max(initial=NOISE) + 1
    count = np.bincount(label[known], minlength=total)
    return np.bincount(label[known], background[known], minlength=total) / np.maximum(count, 1)


def drop_clusters(label: Ints, dropped: Bools) -> tuple[Ints, int]:
    """Return the labels without some clusters, numbered anew without gaps, and the number of those dropped.

    Args:
        label: (n,) cluster of each point, -1 for none.
        dropped: (k,) whether to drop each cluster; its points become noise.
    """
    number = np.where(dropped, NOISE, np.cumsum(~dropped) - 1)
    return np.append(number, NOISE)[label], int(dropped.sum())  # the last entry is that of NOISE = -1


def median_velocities(label: Ints, velocity_mps: Floats) -> Array:
    """Return (k, 3) median velocity of the points of each cluster.

    Args:
        label: (n,) cluster of each point, -1 for none; each cluster has a point.
        velocity_mps: (n, 3) velocity of each point.
    """
    is_member = label != NOISE
    owner, velocity_mps = label[is_member], velocity_mps[is_member]
    count = np.bincount(owner)
    first = np.cumsum(count) - count
    medians = np.zeros((len(count), 3))
    for axis, values in enumerate(velocity_mps.T):
        ordered = values[np.lexsort((values, owner))]
        medians[:, axis] = (ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2
    return medians
