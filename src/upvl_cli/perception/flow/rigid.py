"""Scene flow between two sweeps by one rigid motion for each connected component.

The order is NSFP++'s (MI-UP, Najibi et al., ECCV 2022, section 4.1): ground and ego motion are out already,
static components are taken out, and each remaining component is registered with an expanded box of the other
sweep. In place of a network each component gets a rigid motion by ICP, started from a vote over
displacements: on real pairs that is both nearer the truth and faster.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.perception.clustering import NOISE, dbscan_voxels
from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.evidence import has_end_shifts, has_evidence
from upvl_cli.perception.flow.groups import Groups, Poses, apply_poses, relabel
from upvl_cli.perception.flow.residual import move_parts, residual_mask
from upvl_cli.perception.flow.screen import Screen, screen_components
from upvl_cli.perception.flow.search import FlowState, Labelled, TargetPoints, search_poses
from upvl_cli.perception.flow.spread import spread_motion
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.perception.flow.third import Third, move_by_third, third_sweep
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
    state = FlowState.at_rest(source_xyz_m, target_xyz_m, config.max_speed_mps * abs(dt_s), config.surface)
    component = dbscan_voxels(
        np.concatenate([source_xyz_m, target_xyz_m]),
        eps_m=config.eps_m,
        min_points=config.min_points,
        voxel_m=config.voxel_m,
    )
    of_source, of_target = np.split(component, [total])
    labelled = Labelled(np.arange(total), of_source)
    trees = state.source_tree, state.target_tree
    is_residual = residual_mask(source_xyz_m, None, of_source, trees, state.finest_rad, config)
    screen = screen_components(state, labelled, is_residual, config)
    third = third_sweep(state, others, config)
    _move_components(state, third, labelled, of_target, screen, config)
    if third is not None:
        move_by_third(state, third, labelled, screen, config)
    move_parts(state, third, of_source, of_target, is_residual, config)
    spread_motion(state, third, is_residual, config)
    return state.shift_m / dt_s


def _move_components(
    state: FlowState,
    third: Third | None,
    labelled: Labelled,
    of_target: Ints,
    screen: Screen,
    config: RigidFlowConfig,
) -> None:
    """Give each component the motion that explains it better than rest, unless the third sweep contradicts.

    Args:
        state: The sweeps, and their motion, which is written to.
        third: A third sweep.
        labelled: The points of the first sweep and their components.
        of_target: (m,) component of each point of the second sweep, -1 for none.
        screen: How well components fit at rest.
        config: The method's settings.
    """
    is_off = screen.misfit > config.max_static_misfit
    if third is not None:  # what the third sweep explains at rest stands: something hides it in the second
        is_off[is_off] = third.misfit_at_rest(screen.points, is_off) > config.max_static_misfit
    # Without a third sweep nothing confirms that a long side slides along itself.
    slides = (
        np.zeros_like(is_off)
        if third is None
        else has_end_shifts(
            state,
            labelled.among(screen.component),
            relabel(of_target, screen.component),
            screen.has_residual & ~is_off,
            config.evidence,
        )
    )
    searched = np.flatnonzero(is_off | slides)
    component, floor = screen.component[searched], np.where(is_off, config.max_static_misfit, 0.0)[searched]
    label = relabel(of_target, component)
    # No moving component corresponds to points of a static one, nor of one that only the second sweep has;
    # noise may be a part of it.
    candidate = (of_target == NOISE) | (label >= 0)
    if not len(component) or not candidate.any():
        return
    labelled = labelled.among(component)
    candidates = TargetPoints(state.target_m[candidate], label[candidate])
    # The misfit of a long side drops little; its ends and the third sweep decide.
    share = np.where(is_off[searched], 1 - config.min_gain, 1.0)
    found = search_poses(state, labelled, candidates, floor, share, config)
    needs_evidence = found.is_hidden | (floor[found.group] < config.max_static_misfit)
    moves = ~needs_evidence
    if third is not None:
        moved, rest = third.misfits(found)
        evident = needs_evidence & (moved < (1 - config.min_gain) * rest)
        evident[evident] = has_evidence(state, found.select(evident), candidates, config)
        moves = (moves & (moved <= config.evidence.contradiction * rest)) | evident
    found = found.select(moves)
    gain = np.bincount(labelled.group)[found.group] * (found.rest - found.cost)
    found = found.select(occupies_most_cells(found.points.groups, found.poses, gain, config.occupancy_cell_m))
    state.move(labelled, found.group, found.points.groups, found.poses)


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
