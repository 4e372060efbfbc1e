"""Second pass of flow: moving parts of components, which the motion of the component leaves unexplained."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.clustering import dbscan_voxels
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.displacement_vote import mean_nearest_m
from upvl_cli.perception.flow.groups import Poses, group_means, relabel, sample_groups, static_poses
from upvl_cli.perception.flow.search import FlowState, search_poses
from upvl_cli.perception.flow.surface import build_tree, estimate_surface, misfit
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats, Ints


def move_parts(
    state: FlowState, component_of_source: Ints, component_of_target: Ints, config: RigidFlowConfig
) -> None:
    """Split components that have unexplained patches into finer parts, and give each part its own motion.

    A walker beside a parked car is one component with it, and at rest with it after the first pass. A part
    whose own motion fits better takes it; one that fits better at rest than under its component's motion
    comes to rest.

    Args:
        state: The sweeps, and their motion so far, which is written to.
        component_of_source: (n,) component of each point of the first sweep, -1 for none.
        component_of_target: (m,) the same for the second.
        config: The method's settings.
    """
    motion = np.column_stack([state.shift_m, state.yaw_rad])
    has_residual = (component_of_source >= 0) & residual_mask(
        state.source_m, motion, component_of_source, state.source_tree, state.target_tree, config
    )
    split = np.flatnonzero(np.bincount(component_of_source[has_residual]) >= config.residual.min_points)
    source = np.flatnonzero(np.isin(component_of_source, split))
    target = np.flatnonzero(np.isin(component_of_target, split))
    if not len(source) or not len(target):
        return
    target_m = state.target_m[target]
    unmatched = residual_mask(
        target_m,
        np.zeros((len(target), 4)),
        component_of_target[target],
        state.target_tree,
        build_tree(state.source_m + state.shift_m),
        config,
    )
    active = (has_residual | (state.shift_m != 0).any(axis=1))[source]
    source, candidate_m = source[active], target_m[unmatched]
    part = dbscan_voxels(
        np.concatenate([state.source_m[source], candidate_m]),
        eps_m=config.eps_m * config.residual.scale,
        min_points=config.min_points,
        voxel_m=config.voxel_m * config.residual.scale,
    )
    of_source, of_candidate = np.split(part, [len(source)])
    size = np.bincount(of_source[of_source >= 0], minlength=part.max(initial=-1) + 1)
    large = np.flatnonzero(size >= config.residual.min_points)
    if len(large) and len(candidate_m):
        labels = relabel(of_source, large), relabel(of_candidate, large)
        _decide(state, source, labels[0], candidate_m, labels[1], len(large), config)


def _decide(
    state: FlowState,
    source: Ints,
    part_of_source: Ints,
    candidate_m: Floats,
    part_of_candidate: Ints,
    total: int,
    config: RigidFlowConfig,
) -> None:
    """Give each part a motion of its own, rest, or the motion that it has, whichever explains it.

    Args:
        state: The sweeps.
        source: (k,) points of the first sweep.
        part_of_source: (k,) part of each, -1 for none.
        candidate_m: (m, 3) points of the second sweep that parts may correspond to.
        part_of_candidate: (m,) part that each lies close to.
        total: Number of parts.
        config: The method's settings.
    """
    points, poses, cost = search_poses(
        state, source, part_of_source, candidate_m, part_of_candidate, total, config
    )
    labelled = part_of_source >= 0
    so_far = state.poses(source[labelled], part_of_source[labelled], points.groups)
    rest = static_poses(points.groups)
    misfit_so_far = misfit(points, state.target_tree, so_far)
    misfit_at_rest = misfit(points, state.target_tree, rest)
    # Beside other objects something that fits by chance is easier to find: the gain is asked for twice.
    best = np.minimum(misfit_at_rest, misfit_so_far)
    moves = (misfit_at_rest > config.max_static_misfit) & (cost < (1 - config.min_gain) ** 2 * best)
    lost = (misfit_so_far > config.max_static_misfit) & (
        misfit_so_far > (1 - config.min_gain) * misfit_at_rest
    )
    rests = ~moves & (lost | (misfit_at_rest < misfit_so_far))
    state.move(source, part_of_source, rests, points.groups, rest)
    state.move(source, part_of_source, moves, points.groups, poses)


def residual_mask(
    xyz_m: Floats, motion: Floats, label: Ints, tree: cKDTree, other_tree: cKDTree, config: RigidFlowConfig
) -> Bools:
    """Return which of (n,) points lie in small patches whose motion does not put them on the other sweep.

    Args:
        xyz_m: (n, 3) points.
        motion: (n, 4) displacement in metres and turn in radians of each.
        label: (n,) points of different labels share no patch.
        tree: All points of the same sweep.
        other_tree: Points of the other sweep.
        config: Patches, surface and the largest misfit of what is explained.
    """
    edge_m, patch_points = config.residual.patch_m, config.residual.patch_points
    patch = voxelize(np.column_stack([xyz_m, (label + 0.5) * edge_m]), voxel_m=edge_m).of_point
    total = int(patch.max(initial=-1)) + 1
    groups = sample_groups(xyz_m, patch, total=total, max_points=patch_points)
    motion = group_means(motion, patch, total)
    poses = Poses(np.arange(total), motion[:, 3], groups.center_m + motion[:, :3])
    range_m = np.linalg.norm(groups.center_m, axis=1)
    # No point spacing is finer: patches within this distance are explained without a surface estimate.
    near_m = config.max_static_misfit * (
        config.surface.range_noise_m + config.residual.min_spacing_rad * range_m
    )
    distance_m = mean_nearest_m(groups, other_tree, poses, config.surface.max_distance_m)
    far = np.flatnonzero(distance_m > near_m)
    patch = relabel(patch, far)
    groups = sample_groups(xyz_m, patch, total=len(far), max_points=patch_points)
    points = estimate_surface(groups, tree, config.surface)
    poses = Poses(np.arange(len(far)), poses.yaw_rad[far], poses.center_m[far])
    return np.append(misfit(points, other_tree, poses) > config.max_static_misfit, False)[patch]
