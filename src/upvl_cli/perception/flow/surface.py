"""Misfit of moved points to the other sweep, measured against how densely their surface is sampled.

Two sweeps never sample the same spots. A point may lie as far from its partner along the surface as its
neighbors do, and nothing has moved; across the surface it may not. So the residual of each point is its
distance to the planar patch around its partner, in units of the point spacing of its own neighborhood.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.config import FlowSurfaceConfig
from upvl_cli.perception.flow.groups import Groups, Poses, apply_poses, rotate_about_z
from upvl_cli.types import Bools, Floats, Ints

TINY = 1e-30  # keeps points that all lie in one place from dividing by nothing


class LocalSurface(NamedTuple):
    """Groups of points, with an estimate of the surface around each point.

    Attributes:
        groups: The points.
        spacing_m: (n,) expected distance from a point to the nearest one of another sweep of the same surface.
        normal: (n, 3) unit normals.
        is_flat: (n,) whether the neighborhood is a plane, so that the normal has a meaning.
        config: How misfits are measured.
    """

    groups: Groups
    spacing_m: Floats
    normal: Floats
    is_flat: Bools
    config: FlowSurfaceConfig


def estimate_surface(groups: Groups, tree: cKDTree, config: FlowSurfaceConfig) -> LocalSurface:
    """Estimate point spacing and normal of the surface around points from their neighbors.

    Args:
        groups: Points of a sweep.
        tree: All points of that sweep, these included.
        config: Neighborhood and flatness.
    """
    distance, near = tree.query(
        groups.xyz_m, k=config.neighbors + 1, distance_upper_bound=config.neighbor_radius_m
    )
    found = np.isfinite(distance)
    patch = tree.data[np.where(found, near, near[:, :1])]
    # Poisson points of density d: the k-th neighbor is sqrt(k / (pi d)) away, the nearest of another sample
    # of the same surface 1 / (2 sqrt(d)).
    width_m = np.where(found, distance, config.neighbor_radius_m)[:, -1]
    spacing_m = 0.5 * np.sqrt(np.pi / config.neighbors) * width_m
    normal, is_flat = _fit_planes(patch, config.max_flatness)
    return LocalSurface(groups, spacing_m, normal, is_flat, config)


def finest_spacing_rad(xyz_m: Floats, tree: cKDTree, config: FlowSurfaceConfig) -> float:
    """Measure the angle between neighboring points of a sweep where they lie densest.

    Args:
        xyz_m: (n, 3) points from the sensor.
        tree: The same points.
        config: The neighborhood, the share of points that lie denser, and how many are looked at.
    """
    sample_m = xyz_m[:: max(1, len(xyz_m) // config.spacing_points)]
    width_m = tree.query(sample_m, k=[config.neighbors + 1])[0][:, 0]
    range_m = np.maximum(np.linalg.norm(sample_m, axis=1), TINY)
    spacing_rad = 0.5 * np.sqrt(np.pi / config.neighbors) * width_m / range_m
    spacing_rad = spacing_rad[np.isfinite(spacing_rad)]
    return float(np.quantile(spacing_rad, config.spacing_quantile)) if len(spacing_rad) else 0.0


def _fit_planes(patch: Floats, max_flatness: float) -> tuple[Floats, Bools]:
    """Return the normals of the (n, k, 3) patches' best planes, and which patches are flat.

    The eigenvalues of a symmetric 3 x 3 matrix in closed form (Smith, Eigenvalues of a symmetric 3 x 3
    matrix, CACM 1961): a tenth of the time of the general routine.
    """
    x, y, z = (axis - axis.mean(axis=1, keepdims=True) for axis in np.moveaxis(patch, 2, 0))
    pairs = ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))
    xx, yy, zz, xy, xz, yz = (np.einsum("nk,nk->n", left, right) for left, right in pairs)
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    half_determinant = (a * b * c + 2 * xy * xz * yz - a * yz * yz - b * xz * xz - c * xy * xy) / 2
    angle = np.arccos(np.clip(half_determinant / np.maximum(spread**3, TINY), -1, 1)) / 3
    high, low = mean + 2 * spread * np.cos(angle), mean + 2 * spread * np.cos(angle + 2 * np.pi / 3)
    is_flat = low < max_flatness * (3 * mean - high - low)
    # The normal is the cross product of the two rows of (matrix - low) that span the largest area.
    rows = np.array([[xx - low, xy, xz], [xy, yy - low, yz], [xz, yz, zz - low]]).transpose(2, 0, 1)
    across = np.cross(rows[:, [0, 0, 1]], rows[:, [1, 2, 2]])
    length = np.einsum("nij,nij->ni", across, across)
    longest = length.argmax(axis=1)
    at = np.arange(len(patch))
    normal = across[at, longest] / np.sqrt(np.maximum(length[at, longest], TINY))[:, None]
    return normal, is_flat & (length[at, longest] > TINY)


def misfit(surface: LocalSurface, tree: cKDTree, poses: Poses) -> Floats:
    """Return the (h,) mean residual of each hypothesis' points to the other sweep, in point spacings.

    A static surface that two sweeps sample at random has about 0.5.

    Args:
        surface: Points with the surface around them.
        tree: Points of the other sweep.
        poses: h hypotheses.
    """
    item, point, xyz_m = apply_poses(surface.groups, poses)
    near = tree.query(xyz_m, distance_upper_bound=surface.config.max_distance_m)
    return misfit_of_pairs(surface, tree, poses, Moved(item, point, xyz_m, *near))


class Moved(NamedTuple):
    """Points of hypotheses where these put them.

    Attributes:
        item: (n,) hypothesis of each, ascending.
        point: (n,) which point it is.
        xyz_m: (n, 3) where it is.
        distance_m: (n,) distance to the nearest point of the other sweep; infinite where there is none near.
        partner: (n,) that point.
    """

    item: Ints
    point: Ints
    xyz_m: Floats
    distance_m: Floats
    partner: Ints


def misfit_of_pairs(surface: LocalSurface, tree: cKDTree, poses: Poses, moved: Moved) -> Floats:
    """Return the (h,) misfits of hypotheses whose nearest points are known.

    Args:
        surface: Points with the surface around them.
        tree: Points of the other sweep.
        poses: h hypotheses.
        moved: Their points.
    """
    max_distance_m = surface.config.max_distance_m
    item, point, xyz_m, distance, partner = moved
    found = np.isfinite(distance)
    residual_m = tree.data[np.where(found, partner, 0)] - xyz_m
    normal = surface.normal[point]
    if poses.yaw_rad.any():
        normal = rotate_about_z(poses.yaw_rad[item], normal)
    across_m = np.einsum("ni,ni->n", residual_m, normal)
    along_m = np.sqrt(np.maximum(np.einsum("ni,ni->n", residual_m, residual_m) - across_m**2, 0))
    spacing_m = surface.spacing_m[point]
    patch_m = np.hypot(across_m, np.maximum(along_m - 2 * spacing_m, 0))
    off_m = np.where(surface.is_flat[point] & found, patch_m, np.where(found, distance, max_distance_m))
    unit_m = spacing_m + surface.config.range_noise_m
    off = np.minimum(np.minimum(off_m, max_distance_m) / unit_m, surface.config.max_misfit)
    return np.bincount(item, off, len(poses.group)) / np.maximum(surface.groups.size[poses.group], 1)


def observable_share(surface: LocalSurface, poses: Poses) -> Floats:
    """Return the (h,) share of a hypothesis' points whose surface shows the motion: not flat, or moved across.

    What slides along its own plane may as well be a wall of which another part is seen (the aperture problem).

    Args:
        surface: Points with the surface around them.
        poses: h hypotheses.
    """
    item, point, xyz_m = apply_poses(surface.groups, poses)
    shift_m = xyz_m - surface.groups.xyz_m[point]
    across_m = np.abs(np.einsum("ni,ni->n", shift_m, surface.normal[point]))
    error_m = surface.config.range_noise_m + surface.config.normal_error * np.linalg.norm(shift_m, axis=1)
    is_observable = ~surface.is_flat[point] | (across_m > error_m)
    return np.bincount(item, is_observable, len(poses.group)) / np.maximum(
        surface.groups.size[poses.group], 1
    )


def build_tree(xyz_m: Floats) -> cKDTree:
    """Build a search tree of (n, 3) points; the default one takes longer to build than our queries gain by it."""
    return cKDTree(xyz_m, leafsize=16, compact_nodes=False, balanced_tree=False)
