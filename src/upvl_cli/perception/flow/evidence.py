"""What speaks for a motion that misfits cannot show, and what a third sweep says of it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.config import FlowEvidenceConfig, RigidFlowConfig
from upvl_cli.perception.flow.groups import (
    Groups,
    Poses,
    apply_poses,
    group_sums,
    relabel,
    rotate_about_z,
    sample_groups,
)
from upvl_cli.perception.flow.search import FlowState, Found, Labelled, TargetPoints
from upvl_cli.perception.flow.surface import LocalSurface, estimate_surface
from upvl_cli.types import Bools, Floats, Ints

END_SHARES = (0.02, 0.98)  # of the points of a thing, in their order along it: where its ends are


def has_evidence(state: FlowState, found: Found, candidates: TargetPoints, config: RigidFlowConfig) -> Bools:
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


def has_end_shifts(
    state: FlowState, labelled: Labelled, of_target: Ints, chosen: Bools, config: FlowEvidenceConfig
) -> Bools:
    """Return (g,) whether both ends of a group lie farther on in the second sweep, along its longest extent.

    Args:
        state: The sweeps.
        labelled: Points of the first sweep and their groups.
        of_target: (m,) group of each point of the second sweep, -1 for none.
        chosen: (g,) groups that are asked for.
        config: The least shift.
    """
    kept = np.flatnonzero(chosen)
    labelled, of_target = labelled.among(kept), relabel(of_target, kept)
    total, target = len(kept), np.flatnonzero(of_target >= 0)
    sides = ((state.source_m[labelled.point], labelled.group), (state.target_m[target], of_target[target]))
    here, there = (
        sample_groups(xyz_m, group, total=total, max_points=config.end_points) for xyz_m, group in sides
    )
    group = np.repeat(np.arange(total), here.size)
    x, y, _ = (here.xyz_m - here.center_m[group]).T
    cos, sin = group_sums(np.column_stack([x * x - y * y, 2 * x * y]), group, total).T
    axis_rad = np.arctan2(sin, cos) / 2
    here_m, there_m = (_ends(groups, axis_rad) for groups in (here, there))
    shift_m = there_m - here_m
    longer_m, shorter_m = np.abs(shift_m).max(axis=1), np.abs(shift_m).min(axis=1)
    is_shift = (
        (shift_m.prod(axis=1) > 0)
        & (shorter_m > config.min_change_m)
        & (shorter_m > config.min_end_ratio * longer_m)
        & (longer_m < state.max_shift_m)
    )
    found = np.zeros(len(chosen), np.bool_)
    found[kept] = is_shift
    return found


def _ends(groups: Groups, axis_rad: Floats) -> Floats:
    """Return the (g, 2) percentiles 2 and 98 of points along the (g,) axis of each group; NaN where it has none."""
    total = len(groups.size)
    group = np.repeat(np.arange(total), groups.size)
    along_m = np.cos(axis_rad)[group] * groups.xyz_m[:, 0] + np.sin(axis_rad)[group] * groups.xyz_m[:, 1]
    along_m = along_m[np.lexsort((along_m, group))]
    ends: Floats = np.full((total, 2), np.nan)
    filled = groups.size > 0
    for column, share in enumerate(END_SHARES):
        row = groups.first + (share * np.maximum(groups.size - 1, 0)).astype(np.int64)
        ends[filled, column] = along_m[row[filled]]
    return ends
