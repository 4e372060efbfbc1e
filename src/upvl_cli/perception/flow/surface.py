"""How well moved points lie on the other sweep, measured against how densely their surface is seen.

Two sweeps never hit the same spots. A point may lie as far from its partner along the surface as its
own neighbours do, and nothing has moved; across the surface it may not. So each point is judged by its
distance to the patch that its partner stands for, in units of the spacing that it sees around itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.groups import Groups, Poses, posed, turned
from upvl_cli.types import Bools, Floats

NEIGHBOURS = 8  # that tell spacing and normal of the surface around a point
REACH_M = 3.0  # neighbours farther off tell nothing
NOISE_M = 0.025  # of a LiDAR's range
FLAT = 0.1  # a patch is flat when its thickness is below this share of its width, both as variances
TILT = 0.2  # normals are known to about this, as a sine
TINY = 1e-30  # keeps points that all lie in one place from dividing by nothing
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


def surface(groups: Groups, tree: cKDTree) -> Surface:
    """Look at the neighbours of points in their own sweep.

    Args:
        groups: Points to tell about.
        tree: All points of that sweep, those to tell about included.
    """
    distance, near = tree.query(groups.xyz_m, k=NEIGHBOURS + 1, distance_upper_bound=REACH_M)
    found = np.isfinite(distance)
    patch = tree.data[np.where(found, near, near[:, :1])]
    # The k-th neighbour is sqrt(k / (pi density)) away; the nearest of another sample half of 1 / sqrt(density).
    width_m = np.where(found, distance, REACH_M)[:, -1]
    spacing_m = 0.5 * np.sqrt(np.pi / NEIGHBOURS) * width_m
    normal, flat = _planes(patch)
    return Surface(groups, spacing_m, normal, flat)


def _planes(patch: Floats) -> tuple[Floats, Bools]:
    """Normals of the (n, k, 3) patches' best planes, and which patches are flat.

    The eigenvalues of a symmetric 3 x 3 matrix in closed form (Smith, Eigenvalues of a symmetric 3 x 3
    matrix, CACM 1961): a tenth of the time of the general routine.
    """
    x, y, z = (axis - axis.mean(axis=1, keepdims=True) for axis in np.moveaxis(patch, 2, 0))
    pairs = ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))
    xx, yy, zz, xy, xz, yz = (np.einsum("nk,nk->n", one, other) for one, other in pairs)
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    half_determinant = (a * b * c + 2 * xy * xz * yz - a * yz * yz - b * xz * xz - c * xy * xy) / 2
    angle = np.arccos(np.clip(half_determinant / np.maximum(spread**3, TINY), -1, 1)) / 3
    high, low = mean + 2 * spread * np.cos(angle), mean + 2 * spread * np.cos(angle + 2 * np.pi / 3)
    flat = low < FLAT * (3 * mean - high - low)
    # The normal is across the two rows of (matrix - low) that span most.
    rows = np.array([[xx - low, xy, xz], [xy, yy - low, yz], [xz, yz, zz - low]]).transpose(2, 0, 1)
    across = np.cross(rows[:, [0, 0, 1]], rows[:, [1, 2, 2]])
    length = np.einsum("nij,nij->ni", across, across)
    longest = length.argmax(axis=1)
    at = np.arange(len(patch))
    normal = across[at, longest] / np.sqrt(np.maximum(length[at, longest], TINY))[:, None]
    return normal, flat & (length[at, longest] > TINY)


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
    across_m = np.einsum("ni,ni->n", way_m, turned(poses.yaw_rad[item], surface.normal[point]))
    along_m = np.sqrt(np.maximum(np.einsum("ni,ni->n", way_m, way_m) - across_m**2, 0))
    spacing_m = surface.spacing_m[point]
    patch_m = np.hypot(across_m, np.maximum(along_m - 2 * spacing_m, 0))
    off_m = np.where(surface.flat[point] & found, patch_m, np.where(found, distance, CAP_M))
    off = np.minimum(np.minimum(off_m, CAP_M) / (spacing_m + NOISE_M), MOST)
    return np.bincount(item, off, len(poses.group)) / np.maximum(surface.groups.size[poses.group], 1)


def witnesses(surface: Surface, poses: Poses) -> Floats:
    """(h,) share of a hypothesis' points whose surface would tell the motion: not flat, or moved across.

    What slides along its own plane may as well be a wall of which another part is seen.

    Args:
        surface: The points and what is known around them.
        poses: The hypotheses.
    """
    item, point, place_m = posed(surface.groups, poses)
    way_m = place_m - surface.groups.xyz_m[point]
    across_m = np.abs(np.einsum("ni,ni->n", way_m, surface.normal[point]))
    tells = ~surface.flat[point] | (across_m > NOISE_M + TILT * np.linalg.norm(way_m, axis=1))
    return np.bincount(item, tells, len(poses.group)) / np.maximum(surface.groups.size[poses.group], 1)


def tree_of(xyz_m: Floats) -> cKDTree:
    """A tree that is quick to build; the default one is slower to build than our queries gain by it."""
    return cKDTree(xyz_m, leafsize=16, compact_nodes=False, balanced_tree=False)
