"""Scene flow between two sweeps by one rigid motion for each connected component.

The order is NSFP++'s (MI-UP, Najibi et al., ECCV 2022, section 4.1): ground and ego motion are out already,
static components are taken out, and each remaining component is registered with an expanded box of the other
sweep. In place of a network each component gets a rigid motion by ICP, started from a vote over
displacements: on real pairs that is both nearer the truth and faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.evidence import has_evidence, misfits, scaled
from upvl_cli.perception.flow.groups import Groups, Poses, apply_poses, relabel, static_poses
from upvl_cli.perception.flow.residual import move_parts, residual_mask
from upvl_cli.perception.flow.search import Candidates, FlowState, Labelled, sample_surface, search_poses
from upvl_cli.perception.flow.surface import misfit
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats, Ints


def estimate_rigid_flow(
    source_xyz_m: Floats, others: Sequence[OtherSweep], config: RigidFlowConfig
) -> Floats:
    """Estimate the (n, 3) velocity over the ground of each source point in m/s; 0 for static points.

    Args:
        source_xyz_m: (n, 3) points above the ground.
        others: The sweep that the flow leads to, then any that confirm it.
        config: The method's settings.
    """
    total, (target_xyz_m, dt_s) = len(source_xyz_m), others[0]
    if not total or not len(target_xyz_m):
        return np.zeros((total, 3))
    state = FlowState.at_rest(source_xyz_m, target_xyz_m, config.max_speed_mps * abs(dt_s))
    component = dbscan_voxels(
        np.concatenate([source_xyz_m, target_xyz_m]),
        eps_m=config.eps_m,
        min_points=config.min_points,
        voxel_m=config.voxel_m,
    )
    of_source, of_target = np.split(component, [total])
    labelled = Labelled(np.arange(total), of_source)
    is_residual = residual_mask(
        source_xyz_m, np.zeros((total, 4)), of_source, state.source_tree, state.target_tree, config
    )
    third = None
    if len(others) > 1 and len(others[1].xyz_m):
        third_xyz_m, third_dt_s = others[1]
        third = Third(state.toward(third_xyz_m, config.max_speed_mps * abs(third_dt_s)), third_dt_s / dt_s)
    _move_components(state, third, labelled, of_target, is_residual, config)
    if third is not None:
        _move_by_third(state, third, labelled, config)
    move_parts(state, of_source, of_target, is_residual, config)
    return state.shift_m / dt_s


class Third(NamedTuple):
    """A third sweep.

    Attributes:
        state: The source with the third sweep as its target.
        ratio: Time to the third sweep by that to the target.
    """

    state: FlowState
    ratio: float


def _move_components(
    state: FlowState,
    third: Third | None,
    labelled: Labelled,
    of_target: Ints,
    is_residual: Bools,
    config: RigidFlowConfig,
) -> None:
    """Give each component the motion that explains it better than rest, unless the third sweep contradicts.

    Args:
        state: The sweeps, and their motion, which is written to.
        third: A third sweep.
        labelled: The points of the first sweep and their components.
        of_target: (m,) component of each point of the second sweep, -1 for none.
        is_residual: (n,) which points of the first sweep the second does not explain at rest.
        config: The method's settings.
    """
    component, floor = _searched_components(state, labelled, is_residual, third is not None, config)
    label = relabel(of_target, component)
    # No moving component corresponds to points of a static one, nor of one that only the second sweep has;
    # noise may be a part of it.
    candidate = (of_target == NOISE) | (label >= 0)
    if not len(component) or not candidate.any():
        return
    labelled = labelled.among(component)
    candidates = Candidates(state.target_m[candidate], label[candidate])
    found = search_poses(state, labelled, candidates, floor, 1 - config.min_gain, config)
    needs_evidence = found.is_hidden | (floor[found.group] < config.max_static_misfit)
    moves = ~needs_evidence
    if third is not None:
        poses = scaled(found.points.groups, found.poses, third.ratio)
        moved, rest = misfits(found.points, third.state.target_tree, poses)
        evident = needs_evidence & (moved < (1 - config.min_gain) * rest)
        if evident.any():
            evident[evident] = has_evidence(state, found.select(evident), candidates, config)
        moves = (moves & (moved <= config.evidence.contradiction * rest)) | evident
    found = found.select(moves)
    size = np.bincount(labelled.group, minlength=len(component))[found.group]
    gain = size * (found.rest - found.cost)
    found = found.select(occupies_most_cells(found.points.groups, found.poses, gain, config.occupancy_cell_m))
    state.move(labelled, found.group, found.points.groups, found.poses)


def _searched_components(
    state: FlowState, labelled: Labelled, is_residual: Bools, with_ends: bool, config: RigidFlowConfig
) -> tuple[Ints, Floats]:
    """Return the components whose motion is searched, and the misfit at rest up to which each stands.

    Args:
        state: The sweeps.
        labelled: The points of the first sweep and their components.
        is_residual: (n,) which points of the first sweep the second does not explain at rest.
        with_ends: Whether those count of which only a small part is not explained: both ends of a long side.
        config: The method's settings.
    """
    total = int(labelled.group.max(initial=NOISE)) + 1
    size = np.bincount(labelled.group[labelled.group >= 0], minlength=total)
    residual = np.bincount(labelled.group[is_residual & (labelled.group >= 0)], minlength=total)
    component = np.flatnonzero((size >= config.icp.min_pairs) & (residual > 0))
    points = sample_surface(state, labelled.among(component), len(component), config.screen_points, config)
    is_off = misfit(points, state.target_tree, static_poses(points.groups)) > config.max_static_misfit
    evidence = config.evidence
    has_ends = residual >= np.maximum(evidence.min_points, evidence.min_share * size)
    searched = is_off | (has_ends[component] & with_ends)
    return component[searched], np.where(is_off, config.max_static_misfit, 0.0)[searched]


def _move_by_third(state: FlowState, third: Third, labelled: Labelled, config: RigidFlowConfig) -> None:
    """Move what the second sweep no longer sees, and what is too slow to show in it, by the third sweep.

    Args:
        state: The sweeps, and their motion, which is written to.
        third: The third sweep.
        labelled: The points of the first sweep and their components.
        config: The method's settings.
    """
    still = ~state.shift_m.any(axis=1) & (labelled.group >= 0)
    labelled = Labelled(labelled.point[still], labelled.group[still])
    component = np.flatnonzero(np.bincount(labelled.group) >= config.icp.min_pairs)
    labelled = labelled.among(component)
    points = sample_surface(state, labelled, len(component), config.screen_points, config)
    off = misfit(points, third.state.target_tree, static_poses(points.groups)) > config.max_static_misfit
    component = np.flatnonzero(off)
    labelled = labelled.among(component)
    target_m = _unclaimed(
        third.state, state.source_m[~np.isin(np.arange(len(state.source_m)), labelled.point)], labelled
    )
    if not len(component) or not len(target_m):
        return
    floor = np.full(len(component), config.max_static_misfit)
    found = search_poses(
        third.state,
        labelled,
        Candidates(target_m, np.full(len(target_m), -1)),
        floor,
        1 - config.min_gain,
        config,
    )
    found = found.select(~found.is_hidden)
    moved, rest = misfits(
        found.points, state.target_tree, scaled(found.points.groups, found.poses, 1 / third.ratio)
    )
    vanished = rest > config.evidence.vanished_misfit
    found = found.select(
        (moved <= config.evidence.confirmation * rest)
        | (vanished & (found.cost < (1 - config.min_gain) ** 2 * found.rest))
    )
    poses = scaled(found.points.groups, found.poses, 1 / third.ratio)
    state.move(labelled, found.group, found.points.groups, poses)


def _unclaimed(state: FlowState, standing_m: Floats, labelled: Labelled) -> Floats:
    """Return the points of the target near groups, less those at which something else stands."""
    here_m = state.source_m[labelled.point]
    if not len(here_m):
        return state.target_m[:0]
    low, high = here_m.min(axis=0) - state.max_shift_m, here_m.max(axis=0) + state.max_shift_m
    near = state.target_m[((state.target_m >= low) & (state.target_m <= high)).all(axis=1)]
    return near


def occupies_most_cells(groups: Groups, poses: Poses, gain: Floats, cell_m: float) -> Bools:
    """Return which of h motions keep at least half of the cells that they lead to.

    Two objects cannot be in one place: each cell belongs to the motion of the largest gain that leads there.

    Args:
        groups: Points of the moved groups.
        poses: h hypotheses, one a group.
        gain: (h,) misfit that each explains, summed over its points.
        cell_m: Edge of the cells.
    """
    item, _, xyz_m = apply_poses(groups, poses)
    cell = voxelize(xyz_m, voxel_m=cell_m).of_point
    cell, item = np.divmod(np.unique(cell * len(gain) + item), max(len(gain), 1))
    highest = np.zeros(cell.max(initial=-1) + 1)
    np.maximum.at(highest, cell, gain[item])
    owned = np.bincount(item, gain[item] >= highest[cell], len(gain))
    return np.asarray(2 * owned >= np.bincount(item, minlength=len(gain)))
