"""Two sweeps with the motion estimated so far, and the search for the pose of groups in the second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.config import FlowPlausibilityConfig, RigidFlowConfig
from upvl_cli.perception.flow.displacement_vote import select_starts, start_hypotheses
from upvl_cli.perception.flow.groups import Groups, Poses, group_means, rotate_about_z, sample_groups
from upvl_cli.perception.flow.icp import icp
from upvl_cli.perception.flow.surface import (
    LocalSurface,
    build_tree,
    estimate_surface,
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
    """

    source_m: Floats
    target_m: Floats
    source_tree: cKDTree
    target_tree: cKDTree
    shift_m: Floats
    yaw_rad: Floats
    max_shift_m: float

    @classmethod
    def at_rest(cls, source_m: Floats, target_m: Floats, max_shift_m: float) -> FlowState:
        """Return the state in which nothing has moved."""
        total = len(source_m)
        trees = build_tree(source_m), build_tree(target_m)
        return cls(source_m, target_m, *trees, np.zeros((total, 3)), np.zeros(total), max_shift_m)

    def poses(self, point: Ints, group: Ints, groups: Groups) -> Poses:
        """Return the mean pose of groups by the motion so far.

        Args:
            point: (k,) points of the source.
            group: (k,) group of each.
            groups: Samples of these groups.
        """
        mean = group_means(np.column_stack([self.shift_m, self.yaw_rad])[point], group, len(groups.size))
        return Poses(np.arange(len(mean)), mean[:, 3], groups.center_m + mean[:, :3])

    def move(self, point: Ints, group: Ints, chosen: Bools, groups: Groups, poses: Poses) -> None:
        """Set the motion of the points of the chosen groups to that of their group.

        Args:
            point: (k,) points of the source.
            group: (k,) group of each, -1 for none.
            chosen: (g,) which groups.
            groups: Samples of the groups.
            poses: The pose of each group.
        """
        moved = (group >= 0) & chosen[group]
        point, group = point[moved], group[moved]
        here_m = self.source_m[point]
        local_m = here_m - groups.center_m[group]
        self.shift_m[point] = rotate_about_z(poses.yaw_rad[group], local_m) + poses.center_m[group] - here_m
        self.yaw_rad[point] = poses.yaw_rad[group]


def search_poses(
    state: FlowState,
    point: Ints,
    group: Ints,
    candidate_m: Floats,
    group_of_candidate: Ints,
    total: int,
    config: RigidFlowConfig,
) -> tuple[LocalSurface, Poses, Floats]:
    """Search the pose of lowest cost of each group among points of the other sweep.

    Args:
        state: The sweeps.
        point: (k,) points of the first sweep.
        group: (k,) group of each, -1 for none.
        candidate_m: (m, 3) points of the second that groups may correspond to.
        group_of_candidate: (m,) the group that each lies close to, -1 for none.
        total: Number of groups.
        config: The search.

    Returns:
        The sampled points, one pose for each group, and its (g,) cost: the misfit, plus a share for its length.
    """
    tree = build_tree(candidate_m)

    def sampled(max_points: int) -> LocalSurface:
        groups = sample_groups(state.source_m[point], group, total=total, max_points=max_points)
        return estimate_surface(groups, state.source_tree, config.surface)

    points = sampled(config.icp.coarse_points)
    target_center_m = group_means(candidate_m, group_of_candidate, total)
    poses = start_hypotheses(points.groups, candidate_m, target_center_m, state.max_shift_m, config.vote)
    poses = select_starts(points.groups, tree, poses, config.vote.starts, config.surface.max_distance_m)
    poses = icp(points, tree, poses, config.icp.coarse_radii_m, config.icp)
    cost = _cost(points, tree, poses, config.plausibility)
    too_far = np.linalg.norm(_shift_m(points.groups, poses), axis=1) > state.max_shift_m
    order = np.lexsort((np.where(too_far, np.inf, cost), poses.group))
    poses = poses[order[np.flatnonzero(np.diff(poses.group[order], prepend=-1))]]
    points = sampled(config.icp.fine_points)
    poses = icp(points, tree, poses, config.icp.fine_radii_m, config.icp)
    return points, poses, _cost(points, tree, poses, config.plausibility)


def _cost(points: LocalSurface, tree: cKDTree, poses: Poses, config: FlowPlausibilityConfig) -> Floats:
    """Return the (h,) misfit of hypotheses plus a share for their length; infinite for implausible ones."""
    x, y, z = _shift_m(points.groups, poses).T
    cost = misfit(points, tree, poses) + config.misfit_per_m * np.sqrt(x * x + y * y + z * z)
    rises = np.abs(z) > config.max_rise_m + config.max_rise_slope * np.hypot(x, y)
    is_hidden = observable_share(points, poses) < config.min_observable_share
    return np.where(rises | is_hidden, np.inf, cost)


def _shift_m(groups: Groups, poses: Poses) -> Floats:
    """Return the (h, 3) displacements of the centers of the hypotheses' groups."""
    return poses.center_m - groups.center_m[poses.group]
