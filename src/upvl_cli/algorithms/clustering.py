"""Density clustering of points, at the cost of their voxels."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from upvl_cli.algorithms.voxels import number_in_order, voxelize
from upvl_cli.types import Bools, Floats, Ints

NOISE = -1


def dbscan_voxels(points: Floats, *, eps_m: float, min_points: int, voxel_m: float) -> Ints:
    """Label points by density cluster: DBSCAN on voxel centroids that weigh what they hold.

    A voxel is core when the voxels within `eps_m` of its centroid, itself included, hold at least
    `min_points` points. A voxel at the rim joins its nearest core voxel.

    Args:
        points: (n, d) positions; further columns (flow, features) must be scaled to metres.
        eps_m: Radius of the neighbourhood.
        min_points: Points that make a neighbourhood dense.
        voxel_m: Edge of the voxels; well below `eps_m`.

    Returns:
        (n,) cluster of each point, numbered by first point; -1 where it is noise.

    Ester et al., A Density-Based Algorithm for Discovering Clusters, KDD 1996.
    """
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    voxels = voxelize(points, voxel_m=voxel_m)
    labels = _label(voxels.centroid, voxels.weight, eps_m, min_points)[voxels.of_point]
    kept = labels != NOISE
    labels[kept] = number_in_order(labels[kept])
    return labels


def _label(centroid: Floats, weight: Ints, eps_m: float, min_points: int) -> Ints:
    tree = _tree(centroid)
    left, right = np.ascontiguousarray(tree.query_pairs(eps_m, output_type="ndarray").T)
    total = len(centroid)
    near = weight + np.bincount(left, weight[right], total) + np.bincount(right, weight[left], total)
    core = near >= min_points
    labels = np.full(total, NOISE, dtype=np.int64)
    labels[core] = _components(left, right, core)[core]
    return _attach_rim(labels, centroid, core, eps_m)


def _components(left: Ints, right: Ints, core: Bools) -> Ints:
    both = core[left] & core[right]
    edges = coo_matrix((np.ones(both.sum(), bool), (left[both], right[both])), shape=(len(core), len(core)))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.int64)


def _attach_rim(labels: Ints, centroid: Floats, core: Bools, eps_m: float) -> Ints:
    if core.all() or not core.any():
        return labels
    distance, nearest = _tree(centroid[core]).query(centroid[~core], distance_upper_bound=eps_m)
    rim = np.flatnonzero(~core)[np.isfinite(distance)]
    labels[rim] = labels[core][nearest[np.isfinite(distance)]]
    return labels


def _tree(points: Floats) -> cKDTree:
    # The default tree answers a little sooner, but takes longer to build than is gained here.
    return cKDTree(points, compact_nodes=False, balanced_tree=False)
