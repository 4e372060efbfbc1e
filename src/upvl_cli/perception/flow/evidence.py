"""What speaks for a motion that misfits cannot show, and what a third sweep says of it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.config import FlowEvidenceConfig, RigidFlowConfig
from upvl_cli.perception.flow.groups import (
    Groups,
    Poses,
    apply_poses,
    rotate_about_z,
    sample_groups,
    static_poses,
)
from upvl_cli.perception.flow.search import Candidates, FlowState, Found
from upvl_cli.perception.flow.surface import LocalSurface, estimate_surface, misfit
from upvl_cli.types import Bools, Floats


def has_evidence(state: FlowState, found: Found, candidates: Candidates, config: RigidFlowConfig) -> Bools:
    """Return (k,) whether the ends of a surface that slides along itself show the motion, forward and backward.

    Most points of a long side have a near partner wherever it slides. What tells are the points whose distance to the
    other sweep drops, behind the rear in one sweep and before the front in the other.

    Args:
        state: The sweeps.
        found: k poses.
        candidates: Points of the second sweep, labelled by the groups that were searched.
        config: How many points must speak for a motion.
    """
    forward = _speaks(found.points, state.target_tree, found.poses, config.evidence)
    total = len(found.points.groups.size)
    label = np.full(int(max(candidates.group.max(initial=-1), found.group.max(initial=-1))) + 2, -1)
    label[found.group] = found.poses.group
    groups = sample_groups(
        candidates.xyz_m, label[candidates.group], total=total, max_points=config.icp.fine_points
    )
    surface = estimate_surface(groups, state.target_tree, config.surface)
    return forward & _speaks(surface, state.source_tree, _inverse(groups, found), config.evidence)


def _inverse(groups: Groups, found: Found) -> Poses:
    """Return the poses that move the points of the second sweep back."""
    poses, center_m = found.poses, groups.center_m[found.poses.group]
    back_m = rotate_about_z(-poses.yaw_rad, center_m - poses.center_m)
    return Poses(poses.group, -poses.yaw_rad, back_m + found.points.groups.center_m[poses.group])


def _speaks(points: LocalSurface, tree: cKDTree, poses: Poses, config: FlowEvidenceConfig) -> Bools:
    """Return (h,) whether enough points come closer to the other sweep by a pose, and few go farther."""
    item, point, moved_m = apply_poses(points.groups, poses)
    change_m = tree.query(points.groups.xyz_m[point])[0] - tree.query(moved_m)[0]
    least_m = np.maximum(config.min_change_m, config.min_change * points.spacing_m[point])
    gain, loss = (
        np.bincount(item, part, len(poses.group)) for part in (change_m > least_m, -change_m > least_m)
    )
    needed = np.maximum(config.min_points, config.min_share * points.groups.size[poses.group])
    return np.asarray((gain >= needed) & (gain >= config.min_odds * loss))


def scaled(groups: Groups, poses: Poses, ratio: float) -> Poses:
    """Return where groups that go on steadily are after another time.

    Args:
        groups: The groups.
        poses: Where they are after a time.
        ratio: The other time by that one; negative before.
    """
    center_m = groups.center_m[poses.group]
    return Poses(poses.group, ratio * poses.yaw_rad, center_m + ratio * (poses.center_m - center_m))


def misfits(points: LocalSurface, tree: cKDTree, poses: Poses) -> tuple[Floats, Floats]:
    """Return the (h,) misfits to a sweep of groups by their poses, and those at rest.

    Args:
        points: Samples of the groups.
        tree: The sweep.
        poses: h poses.
    """
    at_rest = misfit(points, tree, static_poses(points.groups))
    return misfit(points, tree, poses), at_rest[poses.group]
