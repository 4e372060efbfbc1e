"""A third sweep: it confirms motions, and shows those that the second one does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.groups import Groups, Poses, static_poses
from upvl_cli.perception.flow.screen import Screen
from upvl_cli.perception.flow.search import FlowState, Found, Labelled, TargetPoints, search_poses
from upvl_cli.perception.flow.surface import LocalSurface, misfit
from upvl_cli.perception.flow.sweeps import OtherSweep
from upvl_cli.types import Array, Floats


class Third(NamedTuple):
    """A third sweep.

    Attributes:
        state: The source with the third sweep as its target.
        ratio: Time to the third sweep by that to the target.
    """

    state: FlowState
    ratio: float

    def misfits(self, found: Found) -> tuple[Floats, Floats]:
        """Return the (k,) misfits to this sweep of motions that go on steadily, and those at rest.

        Args:
            found: Poses in the second sweep.
        """
        return _misfits(self.state, found, self.ratio)

    def misfit_at_rest(self, points: LocalSurface, chosen: Array) -> Floats:
        """Return the misfits to this sweep of some groups at rest.

        Args:
            points: Samples of groups.
            chosen: Mask or numbers of groups.
        """
        return misfit(points, self.state.target_tree, static_poses(points.groups)[chosen])


def third_sweep(state: FlowState, others: Sequence[OtherSweep], config: RigidFlowConfig) -> Third | None:
    """Return the third sweep; None where there is none.

    Args:
        state: The source and the second sweep.
        others: The second sweep, then the third.
        config: The fastest motion.
    """
    if len(others) < 2 or not len(others[1].xyz_m):
        return None
    max_shift_m = config.max_speed_mps * abs(others[1].dt_s)
    return Third(state.toward(others[1].xyz_m, max_shift_m), others[1].dt_s / others[0].dt_s)


def move_by_third(
    state: FlowState, third: Third, labelled: Labelled, screen: Screen, config: RigidFlowConfig
) -> None:
    """Move what the second sweep no longer sees, and what is too slow to show in it, by the third sweep.

    Args:
        state: The sweeps, and their motion, which is written to.
        third: The third sweep.
        labelled: The points of the first sweep and their components.
        screen: How well components fit the second sweep at rest.
        config: The method's settings.
    """
    evidence = config.evidence
    moved = np.unique(labelled.group[state.moves()])
    unsure = np.flatnonzero(
        (screen.misfit > evidence.slow_misfit)
        & (screen.size >= evidence.slow_points)
        & ~np.isin(screen.component, moved)
    )
    off = third.misfit_at_rest(screen.points, unsure) > evidence.third_misfit
    component = screen.component[unsure[off]]
    if not len(component):
        return
    labelled = labelled.among(component)
    target_m = third.state.target_m
    found = search_poses(
        third.state,
        labelled,
        TargetPoints(target_m, np.full(len(target_m), -1)),
        np.full(len(component), config.max_static_misfit),
        np.full(len(component), 1 - config.min_gain),
        config,
    )
    found = found.select(~found.is_hidden)
    moved_misfit, rest = _misfits(state, found, 1 / third.ratio)
    agrees = moved_misfit <= evidence.confirmation * rest
    vanished = (rest > evidence.vanished_misfit) & (found.cost < (1 - config.min_gain) ** 2 * found.rest)
    found = found.select(agrees | vanished)
    groups = found.points.groups
    state.move(labelled, found.group, groups, _scaled(groups, found.poses, 1 / third.ratio))


def _misfits(state: FlowState, found: Found, ratio: float) -> tuple[Floats, Floats]:
    """Return the (k,) misfits to the target of a state of poses that go on for another time, and those at rest."""
    groups = found.points.groups
    at_rest = misfit(found.points, state.target_tree, static_poses(groups)[found.poses.group])
    return misfit(found.points, state.target_tree, _scaled(groups, found.poses, ratio)), at_rest


def _scaled(groups: Groups, poses: Poses, ratio: float) -> Poses:
    """Return where groups that go on steadily are after another time.

    Args:
        groups: The groups.
        poses: Where they are after a time.
        ratio: The other time by that one; negative before.
    """
    center_m = groups.center_m[poses.group]
    return Poses(poses.group, ratio * poses.yaw_rad, center_m + ratio * (poses.center_m - center_m))
