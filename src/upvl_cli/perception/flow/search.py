"""Two sweeps with the motion estimated so far, and the search for the pose of groups in the second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.config import FlowPlausibilityConfig, FlowSurfaceConfig, RigidFlowConfig
from upvl_cli.perception.flow.displacement_vote import mean_nearest_m, select_starts, start_hypotheses
from upvl_cli.perception.flow.groups import (
    Groups,
    Poses,
    group_means,
    relabel,
    rotate_about_z,
    sample_groups,
    static_poses,
)
from upvl_cli.perception.flow.icp import icp
from upvl_cli.perception.flow.surface import (
    LocalSurface,
    build_tree,
    estimate_surface,
    finest_spacing_rad,
    misfit,
    observable_share,
)
from upvl_cli.types import Bools, Floats, Ints


@dataclass(frozen=True)
class FlowState:
    """Two sweeps, and the motion of the first one's points, which is written in place.

    Attributes:
        source_m: (n, 3) points of the first sweep.
        target_m: (m, 3) points of the second, in the same axes.
        source_tree: Search tree of the first sweep.
        target_tree: Search tree of the second.
        shift_m: (n, 3) displacement of each point so far.
        yaw_rad: (n,) turn about the vertical of the object that each point belongs to.
        max_shift_m: Length of the longest motion that is searched for.
        finest_rad: Angle between the points of the first sweep where they lie densest.
    """

    source_m: Floats
    target_m: Floats
    source_tree: cKDTree
    target_tree: cKDTree
    shift_m: Floats
    yaw_rad: Floats
    max_shift_m: float
    finest_rad: float

    @classmethod
    def at_rest(
        cls, source_m: Floats, target_m: Floats, max_shift_m: float, config: FlowSurfaceConfig
    ) -> FlowState:
        """Return the state in which nothing has moved."""
        total = len(source_m)
        trees = build_tree(source_m), build_tree(target_m)
        finest_rad = finest_spacing_rad(source_m, trees[0], config)
        return cls(source_m, target_m, *trees, np.zeros((total, 3)), np.zeros(total), max_shift_m, finest_rad)

    def toward(self, target_m: Floats, max_shift_m: float) -> FlowState:
        """Return the state at rest of the same sweep with another target."""
        total = len(self.source_m)
        rest = np.zeros((total, 3)), np.zeros(total)
        trees = self.source_tree, build_tree(target_m)
        return FlowState(self.source_m, target_m, *trees, *rest, max_shift_m, self.finest_rad)

    def moves(self) -> Bools:
        """Return (n,) which points of the source move."""
        x, y, z = self.shift_m.T
        return np.asarray((x != 0) | (y != 0) | (z != 0))

    def poses(self, labelled: Labelled, groups: Groups) -> Poses:
        """Return the mean pose of groups by the motion so far.

        Args:
            labelled: Points of the source and their groups.
            groups: Samples of these groups.
        """
        motion = np.column_stack([self.shift_m, self.yaw_rad])[labelled.point]
        mean = group_means(motion, labelled.group, len(groups.size))
        return Poses(np.arange(len(mean)), mean[:, 3], groups.center_m + mean[:, :3])

    def move(self, labelled: Labelled, chosen: Ints, groups: Groups, poses: Poses) -> None:
        """Set the motion of the points of some groups to that of their group.

        Args:
            labelled: Points of the source and their groups.
            chosen: (k,) the groups that move, ascending.
            groups: Samples of groups.
            poses: The pose of each of the k; they number groups as `groups` does.
        """
        point, row = labelled.among(chosen)
        here_m = self.source_m[point]
        local_m = here_m - groups.center_m[poses.group[row]]
        self.shift_m[point] = rotate_about_z(poses.yaw_rad[row], local_m) + poses.center_m[row] - here_m
        self.yaw_rad[point] = poses.yaw_rad[row]


class Labelled(NamedTuple):
    """Points that fall into groups.

    Attributes:
        point: (k,) points of the first sweep.
        group: (k,) group of each, -1 for none.
    """

    point: Ints
    group: Ints

    def among(self, kept: Ints) -> Labelled:
        """Return the points of some groups, numbered by their place in `kept`, which ascends."""
        group = relabel(self.group, kept)
        return Labelled(self.point[group >= 0], group[group >= 0])


class TargetPoints(NamedTuple):
    """Points of the second sweep that groups may correspond to.

    Attributes:
        xyz_m: (m, 3) points.
        group: (m,) the group that each lies close to, -1 for none.
    """

    xyz_m: Floats
    group: Ints


class Found(NamedTuple):
    """Poses that explain groups well enough.

    Attributes:
        group: (k,) the groups, ascending.
        points: Samples of them, with the surface around each point.
        poses: The pose of each; they number groups as `points` does.
        cost: (k,) misfit of each, plus a share for its length.
        rest: (k,) misfit at rest.
        is_hidden: (k,) whether the motion runs along the surface that is seen, so that it may be no motion.
    """

    group: Ints
    points: LocalSurface
    poses: Poses
    cost: Floats
    rest: Floats
    is_hidden: Bools

    def select(self, chosen: Bools) -> Found:
        """Return those that a mask selects; `poses` still number all groups of `points`."""
        return Found(
            self.group[chosen],
            self.points,
            self.poses[chosen],
            self.cost[chosen],
            self.rest[chosen],
            self.is_hidden[chosen],
        )


def sample_surface(
    state: FlowState, labelled: Labelled, total: int, max_points: int, config: RigidFlowConfig
) -> LocalSurface:
    """Sample points of each group and estimate the surface around each.

    Args:
        state: The sweeps.
        labelled: Points and their groups.
        total: Number of groups.
        max_points: Points that are sampled from each group at most.
        config: The surface estimate.
    """
    xyz_m = state.source_m[labelled.point]
    groups = sample_groups(xyz_m, labelled.group, total=total, max_points=max_points)
    return estimate_surface(groups, state.source_tree, config.surface)


def search_poses(
    state: FlowState,
    labelled: Labelled,
    candidates: TargetPoints,
    floor: Floats,
    share: Floats,
    config: RigidFlowConfig,
) -> Found:
    """Search the pose of lowest cost of each group among points of the other sweep.

    Groups that the sweep explains at rest, and those that stay far above their limit after the coarse pass, are left
    out of the fine one.

    Args:
        state: The sweeps.
        labelled: Points of the first sweep and their groups.
        candidates: Points of the second that groups may correspond to.
        floor: (g,) misfit at rest up to which a group stands.
        share: (g,) cost below which a pose is of use, as a share of the misfit so far and of that at rest.
        config: The search.

    Returns:
        The groups that have a pose of use.
    """
    points = sample_surface(state, labelled, len(floor), config.icp.coarse_points, config)
    rest, best = _misfits_so_far(state, labelled, points)
    center_m = group_means(candidates.xyz_m, candidates.group, len(floor))
    is_whole = len(candidates.xyz_m) == len(state.target_m)
    tree = state.target_tree if is_whole else build_tree(candidates.xyz_m)
    rest_m = mean_nearest_m(points.groups, state.target_tree, static_poses(points.groups), config.vote.cell_m)
    poses = start_hypotheses(
        points.groups,
        np.flatnonzero(rest > floor),
        rest_m > config.vote.min_distance_m,
        candidates.xyz_m,
        center_m,
        state.max_shift_m,
        config.vote,
    )
    poses = select_starts(points.groups, tree, poses, config.vote.starts, config.surface.max_distance_m)
    poses = icp(points, tree, poses, config.icp.coarse_radii_m, config.icp)
    poses = _best(points, tree, poses, state.max_shift_m, config)
    limit = config.icp.slack * share * best
    poses = poses[_cost(points, tree, poses, config.plausibility) < limit[poses.group]]
    stretched = _stretched(points.groups, poses, config.icp.stretch)
    poses = _best(points, tree, stretched, state.max_shift_m, config)
    is_near = np.ones(len(poses.group), np.bool_)
    group = poses.group[is_near]
    labelled = labelled.among(group)
    points = sample_surface(state, labelled, len(group), config.icp.fine_points, config)
    poses = Poses(np.arange(len(group)), poses.yaw_rad[is_near], poses.center_m[is_near])
    poses = icp(points, tree, poses, config.icp.fine_radii_m, config.icp)
    cost = _cost(points, tree, poses, config.plausibility)
    rest, best = _misfits_so_far(state, labelled, points)
    is_hidden = observable_share(points, poses) < config.plausibility.min_observable_share
    return Found(group, points, poses, cost, rest, is_hidden).select(
        (rest > floor[group]) & (cost < share[group] * best)
    )


def _misfits_so_far(state: FlowState, labelled: Labelled, points: LocalSurface) -> tuple[Floats, Floats]:
    """Return the (g,) misfits at rest of groups, and the lower one of that and the misfit of their motion so far."""
    rest = misfit(points, state.target_tree, static_poses(points.groups))
    if not state.shift_m.any():
        return rest, rest
    return rest, np.minimum(rest, misfit(points, state.target_tree, state.poses(labelled, points.groups)))


def _best(
    points: LocalSurface, tree: cKDTree, poses: Poses, max_shift_m: float, config: RigidFlowConfig
) -> Poses:
    """Return the hypothesis of lowest cost of each group."""
    cost = _cost(points, tree, poses, config.plausibility)
    too_far = np.linalg.norm(_shift_m(points.groups, poses), axis=1) > max_shift_m
    order = np.lexsort((np.where(too_far, np.inf, cost), poses.group))
    return poses[order[np.flatnonzero(np.diff(poses.group[order], prepend=-1))]]


def _stretched(groups: Groups, poses: Poses, factors: tuple[float, ...]) -> Poses:
    """Return hypotheses with their shifts longer by factors: long sides hold ICP back."""
    shift_m = _shift_m(groups, poses)
    center_m = [poses.center_m + (factor - 1) * shift_m for factor in factors]
    return Poses(
        np.tile(poses.group, len(factors)), np.tile(poses.yaw_rad, len(factors)), np.concatenate(center_m)
    )


def _cost(points: LocalSurface, tree: cKDTree, poses: Poses, config: FlowPlausibilityConfig) -> Floats:
    """Return the (h,) misfit of hypotheses plus a share for their length; infinite for implausible ones."""
    x, y, z = _shift_m(points.groups, poses).T
    cost = misfit(points, tree, poses) + config.misfit_per_m * np.sqrt(x * x + y * y + z * z)
    rises = np.abs(z) > config.max_rise_m + config.max_rise_slope * np.hypot(x, y)
    return np.where(rises, np.inf, cost)


def _shift_m(groups: Groups, poses: Poses) -> Floats:
    """Return the (h, 3) displacements of the centers of the hypotheses' groups."""
    return poses.center_m - groups.center_m[poses.group]
