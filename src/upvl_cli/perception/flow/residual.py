"""Second pass of flow: moving parts of components, which the motion of the component leaves unexplained."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.clustering import dbscan_voxels
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.groups import (
    Poses,
    apply_poses,
    group_means,
    relabel,
    sample_groups,
    select_groups,
    static_poses,
)
from upvl_cli.perception.flow.search import FlowState, Labelled, TargetPoints, sample_surface, search_poses
from upvl_cli.perception.flow.spread import rest_where_explained
from upvl_cli.perception.flow.surface import (
    Moved,
    build_tree,
    estimate_surface,
    misfit,
    misfit_of_pairs,
)
from upvl_cli.perception.flow.third import Third
from upvl_cli.perception.voxels import number_in_order, row_keys
from upvl_cli.types import Bools, Floats, Ints


def move_parts(
    state: FlowState,
    third: Third | None,
    component_of_source: Ints,
    component_of_target: Ints,
    is_residual: Bools,
    config: RigidFlowConfig,
) -> None:
    """Split components that have unexplained patches into finer parts, and give each part its own motion.

    A walker beside a parked car is one component with it, and at rest with it after the first pass. A part
    whose own motion fits better takes it; one that fits better at rest than under its component's motion
    comes to rest.

    Args:
        state: The sweeps, and their motion so far, which is written to.
        third: A third sweep; what it explains at rest has no motion of its own.
        component_of_source: (n,) component of each point of the first sweep, -1 for none.
        component_of_target: (m,) the same for the second.
        is_residual: (n,) which points of the first sweep the second does not explain at rest.
        config: The method's settings.
    """
    has_residual = _unexplained(state, third, component_of_source, is_residual, config)
    split = np.flatnonzero(np.bincount(component_of_source[has_residual]) >= config.residual.min_points)
    source = np.flatnonzero(np.isin(component_of_source, split))
    target = np.flatnonzero(np.isin(component_of_target, split))
    if not len(source) or not len(target):
        return
    target_m = state.target_m[target]
    moved_tree = build_tree(state.source_m + state.shift_m) if state.shift_m.any() else state.source_tree
    trees = state.target_tree, moved_tree
    unmatched = residual_mask(target_m, None, component_of_target[target], trees, state.finest_rad, config)
    # A component whose points in the second sweep are all explained has nowhere to go.
    is_open = np.isin(component_of_source[source], component_of_target[target[unmatched]])
    source = source[is_open & (has_residual | state.moves())[source]]
    candidate_m = target_m[unmatched]
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
        labelled = Labelled(source, relabel(of_source, large))
        _decide(state, labelled, TargetPoints(candidate_m, relabel(of_candidate, large)), len(large), config)


def _unexplained(
    state: FlowState, third: Third | None, component: Ints, is_residual: Bools, config: RigidFlowConfig
) -> Bools:
    """Return which points of components the second sweep does not explain by the motion so far.

    What stands in a mixed component comes to rest. At rest the third sweep must not explain a point either.

    Args:
        state: The sweeps, and their motion so far, which is written to.
        third: A third sweep.
        component: (n,) component of each point, -1 for none.
        is_residual: (n,) which points the second sweep does not explain at rest.
        config: The method's settings.
    """
    unexplained = is_residual & (component >= 0)
    moved = np.flatnonzero((component >= 0) & state.moves())
    motion = np.column_stack([state.shift_m, state.yaw_rad])[moved]
    trees = state.source_tree, state.target_tree
    unexplained[moved] = residual_mask(
        state.source_m[moved], motion, component[moved], trees, state.finest_rad, config
    )
    rest_where_explained(state, component, is_residual, unexplained, config.evidence)
    unexplained &= is_residual | state.moves()
    if third is not None:
        rest = np.flatnonzero(unexplained & ~state.moves())
        trees = state.source_tree, third.state.target_tree
        unexplained[rest] = residual_mask(
            state.source_m[rest], None, component[rest], trees, state.finest_rad, config
        )
    return unexplained


def _decide(
    state: FlowState, labelled: Labelled, candidates: TargetPoints, total: int, config: RigidFlowConfig
) -> None:
    """Give each part a motion of its own, rest, or the motion that it has, whichever explains it.

    Args:
        state: The sweeps.
        labelled: Points of the first sweep and their parts.
        candidates: Points of the second sweep that parts may correspond to.
        total: Number of parts.
        config: The method's settings.
    """
    floor = np.full(total, config.max_static_misfit)
    # Beside other objects something that fits by chance is easier to find: the gain is asked for twice.
    share = np.full(total, (1 - config.min_gain) ** 2)
    found = search_poses(state, labelled, candidates, floor, share, config)
    found = found.select(~found.is_hidden)
    _rest(state, labelled, np.setdiff1d(np.arange(total), found.group), config)
    state.move(labelled, found.group, found.points.groups, found.poses)


def _rest(state: FlowState, labelled: Labelled, part: Ints, config: RigidFlowConfig) -> None:
    """Bring those parts to rest that lie on the second sweep as well at rest as by their motion so far.

    Args:
        state: The sweeps.
        labelled: Points of the first sweep and their parts.
        part: (k,) parts.
        config: The method's settings.
    """
    moving = np.unique(labelled.group[state.moves()[labelled.point]])
    part = np.intersect1d(part, moving)
    labelled = labelled.among(part)
    points = sample_surface(state, labelled, len(part), config.icp.fine_points, config)
    rest = static_poses(points.groups)
    misfit_so_far = misfit(points, state.target_tree, state.poses(labelled, points.groups))
    misfit_at_rest = misfit(points, state.target_tree, rest)
    lost = (misfit_so_far > config.max_static_misfit) & (
        misfit_so_far > (1 - config.min_gain) * misfit_at_rest
    )
    rests = np.flatnonzero(lost | (misfit_at_rest < misfit_so_far))
    state.move(labelled, rests, points.groups, rest[rests])


def residual_mask(
    xyz_m: Floats,
    motion: Floats | None,
    label: Ints,
    trees: tuple[cKDTree, cKDTree],
    finest_rad: float,
    config: RigidFlowConfig,
) -> Bools:
    """Return which of (n,) points lie in small patches whose motion does not put them on the other sweep.

    Args:
        xyz_m: (n, 3) points.
        motion: (n, 4) displacement in metres and turn in radians of each; None at rest.
        label: (n,) points of different labels share no patch.
        trees: All points of the same sweep, and those of the other one.
        finest_rad: Angle between the points of the sweep where they lie densest.
        config: Patches, surface and the largest misfit of what is explained.
    """
    if not len(xyz_m):
        return np.zeros(0, np.bool_)
    tree, other_tree = trees
    edge_m, max_distance_m = config.residual.patch_m, config.surface.max_distance_m
    cells = np.floor(np.ascontiguousarray(xyz_m.T) / edge_m).astype(np.int64)
    patch = number_in_order(row_keys(np.concatenate([cells, label[None]]).T))
    total = int(patch.max()) + 1
    groups = sample_groups(xyz_m, patch, total=total, max_points=config.residual.patch_points)
    poses = static_poses(groups)
    if motion is not None:
        mean = group_means(motion, patch, total)
        poses = Poses(poses.group, mean[:, 3], groups.center_m + mean[:, :3])
    item, point, moved_m = apply_poses(groups, poses)
    distance_m, partner = other_tree.query(moved_m, distance_upper_bound=max_distance_m)
    mean_m = np.bincount(item, np.minimum(distance_m, max_distance_m), total) / groups.size
    # No point spacing is finer: patches within this distance are explained without a surface estimate.
    finest_m = finest_rad * np.linalg.norm(groups.center_m, axis=1)
    far = np.flatnonzero(mean_m > config.max_static_misfit * (config.surface.range_noise_m + finest_m))
    surface = estimate_surface(select_groups(groups, far), tree, config.surface)
    near = relabel(item, far)
    kept = near >= 0
    moved = Moved(
        near[kept], np.arange(np.count_nonzero(kept)), moved_m[kept], distance_m[kept], partner[kept]
    )
    poses = Poses(np.arange(len(far)), poses.yaw_rad[far], poses.center_m[far])
    is_off = np.zeros(total, np.bool_)
    is_off[far] = misfit_of_pairs(surface, other_tree, poses, moved) > config.max_static_misfit
    return is_off[patch]
