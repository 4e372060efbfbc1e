"""Where the motion of a component ends: neighbors that share it, and patches that stand."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.flow.config import FlowEvidenceConfig, RigidFlowConfig
from upvl_cli.perception.flow.groups import rotate_about_z
from upvl_cli.perception.flow.search import FlowState
from upvl_cli.perception.flow.surface import build_tree
from upvl_cli.perception.flow.third import Third
from upvl_cli.types import Bools, Floats, Ints


def rest_where_explained(
    state: FlowState, component: Ints, is_residual: Bools, remains: Bools, config: FlowEvidenceConfig
) -> None:
    """Bring the points of mixed components to rest that the second sweep explains at rest, but not by their motion.

    A component is mixed where such points are a large share of it, and most of what its motion leaves unexplained;
    a thing that moves over its own former place is neither.

    Args:
        state: The sweeps, and their motion, which is written to.
        component: (n,) component of each point, -1 for none.
        is_residual: (n,) which points the second sweep does not explain at rest.
        remains: (n,) which it does not explain by their motion.
        config: The shares.
    """
    rests = remains & ~is_residual & (component >= 0)
    total = int(component.max(initial=0)) + 1
    resting, remaining = (np.bincount(component[part], minlength=total) for part in (rests, remains))
    size = np.bincount(component[component >= 0], minlength=total)
    is_mixed = (resting > config.mixed_share * size) & (resting > config.mixed_ratio * remaining)
    rests &= is_mixed[component]
    state.shift_m[rests] = 0
    state.yaw_rad[rests] = 0


def spread_motion(state: FlowState, third: Third | None, is_residual: Bools, config: RigidFlowConfig) -> None:
    """Give unexplained points the motion of the nearest thing that moves, where that explains them.

    Far things fall apart into several components, some too small to have a motion of their own.

    Args:
        state: The sweeps, and their motion, which is written to.
        third: A third sweep; where there is one, it must agree.
        is_residual: (n,) which points the second sweep does not explain at rest.
        config: How far a motion spreads, and how much nearer it must bring a point.
    """
    moves = state.moves()
    moving, open_ = np.flatnonzero(moves), np.flatnonzero(is_residual & ~moves)
    if not len(moving) or not len(open_):
        return
    tree = build_tree(state.source_m[moving])
    distance_m, nearest = tree.query(state.source_m[open_], distance_upper_bound=config.spread_m)
    near = np.isfinite(distance_m)
    point, of = open_[near], moving[nearest[near]]
    here_m, yaw_rad, shift_m = state.source_m[point], state.yaw_rad[of], state.shift_m[of]
    arm_m = here_m - state.source_m[of]
    if yaw_rad.any():
        shift_m = shift_m + rotate_about_z(yaw_rad, arm_m) - arm_m
    fits = _is_nearer(state, here_m, shift_m, config)
    if third is not None:
        fits &= _is_nearer(third.state, here_m, third.ratio * shift_m, config)
    state.shift_m[point[fits]] = shift_m[fits]
    state.yaw_rad[point[fits]] = yaw_rad[fits]


def _is_nearer(state: FlowState, here_m: Floats, shift_m: Floats, config: RigidFlowConfig) -> Bools:
    """Return (n,) whether shifts bring points clearly nearer to the target."""
    at_rest_m = state.target_tree.query(here_m)[0]
    moved_m = state.target_tree.query(here_m + shift_m, distance_upper_bound=config.surface.max_distance_m)[0]
    is_far = at_rest_m > config.evidence.min_change_m
    return np.asarray(is_far & (moved_m < (1 - config.min_gain) * at_rest_m))
