"""Start hypotheses of ICP for each group: the peaks of a histogram of displacements."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.config import FlowVoteConfig
from upvl_cli.perception.flow.groups import Groups, Poses, apply_poses
from upvl_cli.types import Array, Bools, Floats, Ints


def start_hypotheses(
    groups: Groups,
    chosen: Ints,
    votes: Bools,
    target_m: Floats,
    target_center_m: Floats,
    max_shift_m: float,
    config: FlowVoteConfig,
) -> Poses:
    """Return the start hypotheses of some groups: at rest, the shift of its center, then the peaks of the vote.

    Args:
        groups: Points to move.
        chosen: (k,) the groups, ascending.
        votes: (g,) whether the points of each group vote; else it has the other hypotheses alone.
        target_m: (m, 3) points of the other sweep that they may correspond to.
        target_center_m: (g, 3) center of the points of each component in the other sweep; NaN where there are none.
        max_shift_m: Displacements longer than this do not vote.
        config: The histogram.
    """
    group, shift_m = [np.zeros(0, np.int64)], [np.zeros((0, 2))]
    for number in chosen:
        first = groups.first[number]
        shifts = np.stack([np.zeros(2), (target_center_m[number] - groups.center_m[number])[:2]])
        shifts = shifts[np.hypot(*shifts.T) <= max_shift_m]  # false for what is not finite
        if votes[number]:
            xyz_m = groups.xyz_m[first : first + groups.size[number]]
            shifts = np.concatenate([shifts, _vote(xyz_m, target_m, max_shift_m, config)])
        group.append(np.full(len(shifts), number))
        shift_m.append(shifts)
    group_of_hypothesis = np.concatenate(group)
    center_m = groups.center_m[group_of_hypothesis]
    center_m[:, :2] += np.concatenate(shift_m)
    return Poses(group_of_hypothesis, np.zeros(len(group_of_hypothesis)), center_m)


def _vote(source_m: Floats, target_m: Floats, max_shift_m: float, config: FlowVoteConfig) -> Array:
    """Return the (k, 2) horizontal displacements that most pairs of points agree on, the most frequent first."""
    margin_m = np.array([max_shift_m, max_shift_m, config.max_rise_m])
    low, high = source_m.min(axis=0) - margin_m, source_m.max(axis=0) + margin_m
    x, y, z = target_m.T
    near = target_m[
        (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2])
    ]
    near = near[:: max(1, len(near) // config.max_points)]
    x, y, z = (there[:, None] - here for there, here in zip(near.T, source_m.T, strict=True))
    counts = (np.abs(z) < config.max_rise_m) & (x * x + y * y <= max_shift_m**2)
    half = int(max_shift_m / config.cell_m) + 1
    x, y = (np.floor(shift[counts] / config.cell_m).astype(np.int64) + half for shift in (x, y))
    votes = np.bincount(x * 2 * half + y, minlength=4 * half * half)
    peaks = np.argsort(-votes, kind="stable")[: config.peaks]
    peaks = peaks[votes[peaks] > 0]
    return (np.stack([peaks // (2 * half), peaks % (2 * half)], axis=1) - half + 0.5) * config.cell_m


def select_starts(groups: Groups, tree: cKDTree, poses: Poses, starts: int, max_distance_m: float) -> Poses:
    """Return the first hypothesis of each group and the nearest of its others, unless they are no nearer.

    Args:
        groups: Points to move.
        tree: Points of the other sweep.
        poses: Hypotheses in order of their group.
        starts: How many to return of each group, besides its first.
        max_distance_m: Distance of a point without partner.
    """
    distance_m = mean_nearest_m(groups, tree, poses, max_distance_m)
    first = np.flatnonzero(np.diff(poses.group, prepend=-1))
    is_nearer = distance_m < distance_m[first[np.searchsorted(poses.group[first], poses.group)]]
    is_nearer[first], distance_m[first] = True, -1
    order = np.lexsort((distance_m, poses.group))
    rank = np.arange(len(order)) - np.searchsorted(poses.group, poses.group)
    return poses[np.sort(order[(rank <= starts) & is_nearer[order]])]


def mean_nearest_m(groups: Groups, tree: cKDTree, poses: Poses, max_distance_m: float) -> Floats:
    """Return the (h,) mean distance of each hypothesis' points to their nearest point of the other sweep.

    Args:
        groups: Points to move.
        tree: Points of the other sweep.
        poses: h hypotheses.
        max_distance_m: Distance of a point without partner.
    """
    item, _, xyz_m = apply_poses(groups, poses)
    distance = np.minimum(tree.query(xyz_m, distance_upper_bound=max_distance_m)[0], max_distance_m)
    return np.bincount(item, distance, len(poses.group)) / np.maximum(groups.size[poses.group], 1)
