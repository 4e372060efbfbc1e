"""Density clustering of points, at the cost of their voxels."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from upvl_cli.perception.voxels import number_in_order, voxelize
from upvl_cli.types import Bools, Floats, Ints

NOISE = -1
RADIUS_STEP = 1.25  # radii are rounded down to powers of this: one neighbor search serves many points


def dbscan_voxels(
    points: Floats, *, eps_m: float, min_points: int, voxel_m: float, reach_m: Floats | None = None
) -> Ints:
    """Cluster points by density: DBSCAN on voxel centroids, weighted by the number of their points.

    A voxel is a core voxel when the voxels within `eps_m` of its centroid, itself included, hold at least
    `min_points` points. A border voxel joins its nearest core voxel.
    Ester et al., A Density-Based Algorithm for Discovering Clusters, KDD 1996.

    Args:
        points: (n, d) positions; further columns (flow, features) must be scaled to metres.
        eps_m: Radius of the neighborhood.
        min_points: Points that make a neighborhood dense.
        voxel_m: Edge of the voxels; well below `eps_m`.
        reach_m: (n,) radius of the neighborhood of each point, at least `eps_m`, rounded down to steps of a
            quarter; the smaller one of two points decides whether they are neighbors.

    Returns:
        (n,) cluster of each point, numbered by first point; -1 where it is noise.
    """
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    voxels = voxelize(points, voxel_m=voxel_m)
    level = np.zeros(len(voxels.weight), dtype=np.int64)
    if reach_m is not None:
        reach = np.bincount(voxels.of_point, reach_m, len(level)) / voxels.weight
        level = np.floor(np.log(np.maximum(reach / eps_m, 1.0)) / np.log(RADIUS_STEP) + 1e-9).astype(np.int64)
    labels = _label(voxels.centroid, voxels.weight, eps_m * RADIUS_STEP**level, min_points)[voxels.of_point]
    kept = labels != NOISE
    labels[kept] = number_in_order(labels[kept])
    return labels


def _label(centroid: Floats, weight: Ints, reach: Floats, min_points: int) -> Ints:
    left, right = _neighbor_pairs(centroid, reach)
    total = len(centroid)
    near = weight + np.bincount(left, weight[right], total) + np.bincount(right, weight[left], total)
    core = near >= min_points
    labels = np.full(total, NOISE, dtype=np.int64)
    labels[core] = _components(left, right, core)[core]
    return _attach_border(labels, centroid, core, reach)


def _neighbor_pairs(centroid: Floats, reach: Floats) -> tuple[Ints, Ints]:
    """Return pairs of voxels that are no farther apart than the smaller of their reaches, each pair once."""
    pairs, closer = [], 0.0
    for radius in np.unique(reach):
        far = np.flatnonzero(reach >= radius)  # few, where the radius is large
        left, right = _tree(centroid[far]).query_pairs(radius, output_type="ndarray").T
        if closer:
            new = np.linalg.norm(centroid[far[left]] - centroid[far[right]], axis=1) > closer
            left, right = left[new], right[new]
        pairs.append((far[left], far[right]))
        closer = radius
    return np.concatenate([left for left, _ in pairs]), np.concatenate([right for _, right in pairs])


def _components(left: Ints, right: Ints, core: Bools) -> Ints:
    both = core[left] & core[right]
    edges = coo_matrix((np.ones(both.sum(), bool), (left[both], right[both])), shape=(len(core), len(core)))
    return np.asarray(connected_components(edges, directed=False)[1], dtype=np.int64)


def _attach_border(labels: Ints, centroid: Floats, core: Bools, reach: Floats) -> Ints:
    if core.all() or not core.any():
        return labels
    distance, nearest = _tree(centroid[core]).query(centroid[~core], distance_upper_bound=reach.max())
    near = distance <= reach[~core]
    labels[np.flatnonzero(~core)[near]] = labels[core][nearest[near]]
    return labels


def _tree(points: Floats) -> cKDTree:
    # The default tree answers a little sooner, but takes longer to build than is gained here.
    return cKDTree(points, compact_nodes=False, balanced_tree=False)
