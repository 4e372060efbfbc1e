"""Motion of points between two sweeps: one rigid motion for each connected component.

The order is NSFP++'s (MI-UP, Najibi et al., ECCV 2022, section 4.1): ground and ego motion are out
already, what stands still is taken out, the rest falls into components, each looks for itself in an
expanded box of the other sweep. In place of a network each component gets a rigid motion by ICP,
started from a vote over displacements: on real pairs that is both nearer the truth and faster.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.algorithms.clustering import NOISE, dbscan_voxels
from upvl_cli.algorithms.flow_groups import Poses, sample, still, sums, turned
from upvl_cli.algorithms.flow_motion import MIN_PAIRS, best_starts, icp, nearest_m, starts
from upvl_cli.algorithms.flow_surface import NOISE_M, Surface, misfit, surface, tree_of
from upvl_cli.types import Floats, Ints

SCREEN = 48  # points of a component that tell whether it may have moved,
SEARCH = 80  # that look for its motion,
REFINE = 400  # and that make it exact
SEARCH_RADII_M = (1.0, 0.7, 0.5, 0.4, 0.3, 0.3, 0.3)
REFINE_RADII_M = (0.3, 0.2, 0.2)
FAR_MISFIT = 0.05  # what a metre of motion must gain: of two places that fit alike, the nearer is likelier


def estimate(
    source_xyz_m: Floats,
    target_xyz_m: Floats,
    dt_s: float,
    *,
    max_speed_mps: float,
    eps_m: float,
    min_points: int,
    voxel_m: float,
    still_misfit: float,
    min_gain: float,
) -> Floats:
    """(n, 3) velocity of each source point over the ground, 0 where it stands still.

    Args:
        source_xyz_m: (n, 3) points above the ground.
        target_xyz_m: (m, 3) the same of the other sweep, in the axes of the source.
        dt_s: Time from source to target; negative when the target came before.
        max_speed_mps: A faster component is noise, and gets no motion.
        eps_m: Points closer than this are one component, in both sweeps together.
        min_points: Points that make a neighbourhood dense.
        voxel_m: Points closer than this count as one place when components are made.
        still_misfit: A component this close to the other sweep, in spacings of its points, stands still.
        min_gain: Motion must lower the misfit by this share.
    """
    velocity = np.zeros((len(source_xyz_m), 3))
    if not len(source_xyz_m) or not len(target_xyz_m):
        return velocity
    label = dbscan_voxels(
        np.concatenate([source_xyz_m, target_xyz_m]), eps_m=eps_m, min_points=min_points, voxel_m=voxel_m
    )
    of_source, of_target = np.split(label, [len(source_xyz_m)])
    tree = tree_of(target_xyz_m)
    restless = _restless(source_xyz_m, of_source, tree, still_misfit)
    # What stands still is nothing that something else has become; noise may be.
    free_m = target_xyz_m[np.isin(of_target, [NOISE, *restless])]
    if not len(restless) or not len(free_m):
        return velocity
    of_source, of_target = _renumbered(of_source, restless), _renumbered(of_target, restless)
    free, reach_m = tree_of(free_m), max_speed_mps * abs(dt_s)
    own_centre_m = _centres(target_xyz_m, of_target, len(restless))
    poses = _searched(source_xyz_m, of_source, free, own_centre_m, reach_m)
    found = _seen(source_xyz_m, of_source, len(restless), REFINE)
    poses = icp(found.groups, free, poses, REFINE_RADII_M)
    before, after = misfit(found, tree, still(found.groups)), misfit(found, free, poses)
    way_m = np.linalg.norm(poses.place_m - found.groups.centre_m, axis=1)
    moves = (before > still_misfit) & (after < (1 - min_gain) * before) & (way_m <= reach_m)
    chosen = np.flatnonzero((of_source >= 0) & moves[of_source])
    group = of_source[chosen]
    local_m = source_xyz_m[chosen] - found.groups.centre_m[group]
    moved_m = turned(poses.yaw_rad[group], local_m) + poses.place_m[group]
    velocity[chosen] = (moved_m - source_xyz_m[chosen]) / dt_s
    return velocity


def _restless(source_xyz_m: Floats, of_source: Ints, tree: cKDTree, still_misfit: float) -> Ints:
    """The components that do not lie on the other sweep, by a sample of their points."""
    total = int(of_source.max(initial=NOISE)) + 1
    groups = sample(source_xyz_m, of_source, total=total, most=SCREEN)
    off = np.flatnonzero((groups.size >= MIN_PAIRS) & (nearest_m(groups, tree, still(groups)) > NOISE_M))
    seen = _seen(source_xyz_m, _renumbered(of_source, off), len(off), SCREEN)
    return off[misfit(seen, tree, still(seen.groups)) > still_misfit]


def _searched(
    source_xyz_m: Floats, of_source: Ints, free: cKDTree, own_centre_m: Floats, reach_m: float
) -> Poses:
    """The likeliest pose of each component."""
    seen = _seen(source_xyz_m, of_source, len(own_centre_m), SEARCH)
    poses = best_starts(seen.groups, free, starts(seen.groups, free.data, own_centre_m, reach_m))
    poses = icp(seen.groups, free, poses, SEARCH_RADII_M)
    way_m = np.linalg.norm(poses.place_m - seen.groups.centre_m[poses.group], axis=1)
    cost = misfit(seen, free, poses) + FAR_MISFIT * way_m
    order = np.lexsort((cost, poses.group))
    best = order[np.flatnonzero(np.diff(poses.group[order], prepend=-1))]
    return poses[best]


def _seen(source_xyz_m: Floats, of_source: Ints, total: int, most: int) -> Surface:
    """A sample of each component, and the surface around its points."""
    groups = sample(source_xyz_m, of_source, total=total, most=most)
    return surface(groups, source_xyz_m[of_source >= 0])


def _centres(xyz_m: Floats, group: Ints, total: int) -> Floats:
    """(total, 3) mean of the points of each group; NaN where they are too few."""
    size = np.bincount(group[group >= 0], minlength=total)[:, None]
    mean_m = sums(group[group >= 0], xyz_m[group >= 0], total) / np.maximum(size, 1)
    return np.where(size >= MIN_PAIRS, mean_m, np.nan)


def _renumbered(label: Ints, kept: Ints) -> Ints:
    """Labels as places in `kept`, which ascends; -1 for all others."""
    place = np.searchsorted(kept, label)
    found = place < len(kept)
    found[found] = kept[place[found]] == label[found]
    return np.where(found, place, NOISE)
