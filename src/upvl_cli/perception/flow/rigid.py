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
from upvl_cli.perception.flow.displacement_vote import mean_nearest_m
from upvl_cli.perception.flow.groups import Groups, Poses, apply_poses, relabel, sample_groups, static_poses
from upvl_cli.perception.flow.residual import move_parts
from upvl_cli.perception.flow.search import FlowState, search_poses
from upvl_cli.perception.flow.surface import estimate_surface, misfit
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
    _move_components(state, of_source, of_target, config)
    move_parts(state, of_source, of_target, config)
    return state.shift_m / dt_s


def _move_components(
    state: FlowState, component_of_source: Ints, component_of_target: Ints, config: RigidFlowConfig
) -> None:
    """Give each component the motion that explains it better than rest.

    Args:
        state: The sweeps, and their motion, which is written to.
        component_of_source: (n,) component of each point of the first sweep, -1 for none.
        component_of_target: (m,) the same for the second.
        config: The method's settings.
    """
    dynamic = _dynamic_components(state, component_of_source, config)
    of_source, of_target = relabel(component_of_source, dynamic), relabel(component_of_target, dynamic)
    # No moving component corresponds to points of a static one, nor of one that only the second sweep has;
    # noise may be a part of it.
    candidate = (component_of_target == NOISE) | (of_target >= 0)
    if not len(dynamic) or not candidate.any():
        return
    every_point = np.arange(len(of_source))
    points, poses, cost = search_poses(
        state, every_point, of_source, state.target_m[candidate], of_target[candidate], len(dynamic), config
    )
    misfit_at_rest = misfit(points, state.target_tree, static_poses(points.groups))
    moves = (misfit_at_rest > config.max_static_misfit) & (cost < (1 - config.min_gain) * misfit_at_rest)
    gain = np.bincount(of_source[of_source >= 0]) * (misfit_at_rest - cost)
    moves[moves] = occupies_most_cells(points.groups, poses[moves], gain[moves], config.occupancy_cell_m)
    state.move(every_point, of_source, moves, points.groups, poses)


def _dynamic_components(state: FlowState, component: Ints, config: RigidFlowConfig) -> Ints:
    """Return the numbers of the components whose sampled points do not lie on the other sweep."""
    total = int(component.max(initial=NOISE)) + 1
    groups = sample_groups(state.source_m, component, total=total, max_points=config.screen_points)
    rest = static_poses(groups)
    distance_m = mean_nearest_m(groups, state.target_tree, rest, config.surface.max_distance_m)
    off = np.flatnonzero((groups.size >= config.icp.min_pairs) & (distance_m > config.surface.range_noise_m))
    groups = sample_groups(
        state.source_m, relabel(component, off), total=len(off), max_points=config.screen_points
    )
    points = estimate_surface(groups, state.source_tree, config.surface)
    return off[misfit(points, state.target_tree, static_poses(groups)) > config.max_static_misfit]


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
