"""How well moved points lie on the other sweep, measured against how densely their surface is seen.

Two sweeps never hit the same spots. A point may lie as far from its partner along the surface as its
own neighbours do, and nothing has moved; across the surface it may not. So each point is judged by its
distance to the patch that its partner stands for, in units of the spacing that it sees around itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.algorithms.flow_groups import Groups, Poses, posed, turned
from upvl_cli.types import Bools, Floats

NEIGHBOURS = 10  # that tell spacing and normal of the surface around a point
REACH_M = 3.0  # neighbours farther off tell nothing
NOISE_M = 0.02  # of a LiDAR's range
FLAT = 0.1  # a patch is flat when its thickness is below this share of its width, both as variances
CAP_M = 0.5  # a point without partner counts as this far off
MOST = 5.0  # and no point for more than this many spacings


class Surface(NamedTuple):
    """Groups of points, and what is known of the surface around each point.

    Attributes:
        groups: The points.
        spacing_m: (n,) mean distance to the nearest point that another sweep would have.
        normal: (n, 3) unit normals.
        flat: (n,) whether the normal means something.
    """

    groups: Groups
    spacing_m: Floats
    normal: Floats
    flat: Bools


def surface(groups: Groups, around_m: Floats) -> Surface:
    """Look at the neighbours of points in their own sweep.

    Args:
        groups: Points to tell about.
        around_m: (m, 3) all points of the same things, those to tell about included.
    """
    distance, near = tree_of(around_m).query(groups.xyz_m, k=NEIGHBOURS + 1, distance_upper_bound=REACH_M)
    found = np.isfinite(distance)
    patch = around_m[np.where(found, near, near[:, :1])]
    offset = patch - patch.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offset, offset))
    # The k-th neighbour is sqrt(k / (pi density)) away; the nearest of another sample half of 1 / sqrt(density).
    width_m = np.where(found, distance, REACH_M)[:, -1]
    spacing_m = 0.5 * np.sqrt(np.pi / NEIGHBOURS) * width_m
    return Surface(groups, spacing_m, axes[:, :, 0], spread[:, 0] < FLAT * spread[:, 1])


def misfit(surface: Surface, tree: cKDTree, poses: Poses) -> Floats:
    """(h,) mean distance of each hypothesis' points to the other sweep, in spacings: 1 is doubtful.

    Args:
        surface: The points and what is known around them.
        tree: Points of the other sweep.
        poses: The hypotheses.
    """
    item, point, place_m = posed(surface.groups, poses)
    distance, partner = tree.query(place_m, distance_upper_bound=CAP_M)
    found = np.isfinite(distance)
    way_m = tree.data[np.where(found, partner, 0)] - place_m
    across_m = (way_m * turned(poses.yaw_rad[item], surface.normal[point])).sum(axis=1)
    along_m = np.sqrt(np.maximum((way_m**2).sum(axis=1) - across_m**2, 0))
    spacing_m = surface.spacing_m[point]
    patch_m = np.hypot(across_m, np.maximum(along_m - 2 * spacing_m, 0))
    off_m = np.where(surface.flat[point] & found, patch_m, np.where(found, distance, CAP_M))
    off = np.minimum(np.minimum(off_m, CAP_M) / (spacing_m + NOISE_M), MOST)
    return np.bincount(item, off, len(poses.group)) / np.maximum(surface.groups.size[poses.group], 1)


def tree_of(xyz_m: Floats) -> cKDTree:
    """A tree that is quick to build; the default one is slower to build than our queries gain by it."""
    return cKDTree(xyz_m, leafsize=16, compact_nodes=False, balanced_tree=False)
