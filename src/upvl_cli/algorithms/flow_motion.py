"""Where groups of points went: starts by a vote over displacements, then ICP, for all groups together."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.algorithms.flow_groups import Groups, Poses, posed, sums
from upvl_cli.types import Array, Floats, Ints

VOTERS = 300  # points of the other sweep that vote for one group
CELL_M = 0.3  # of the vote
LEVEL_M = 0.2  # pairs that differ more in height do not vote
VOTES = 3  # best cells that become starts
STARTS = 2  # best starts that are followed, besides standing still
CAP_M = 0.5  # a point without partner counts as this far off
MIN_PAIRS = 5  # fewer fix no motion
CLOSE = 0.004  # metres and radians; a smaller step ends the search


def starts(groups: Groups, target_m: Floats, own_centre_m: Floats, reach_m: float) -> Poses:
    """Hypotheses to begin with: for each group its own place, then where it may have gone.

    Args:
        groups: Points to move.
        target_m: (m, 3) points of the other sweep that they may have become.
        own_centre_m: (g, 3) centre of the other sweep's part of each group; NaN where it has none.
        reach_m: Farther displacements are left out.
    """
    group, shift_m = [], []
    for one in range(len(groups.size)):
        mine = groups.xyz_m[groups.first[one] : groups.first[one] + groups.size[one]]
        shifts = np.concatenate(
            [
                np.zeros((1, 2)),
                (own_centre_m - groups.centre_m)[one : one + 1, :2],
                _voted(mine, target_m, reach_m),
            ]
        )
        shifts = shifts[np.isfinite(shifts).all(axis=1)]
        group.append(np.full(len(shifts), one))
        shift_m.append(shifts)
    of = np.concatenate(group)
    place_m = groups.centre_m[of]
    place_m[:, :2] += np.concatenate(shift_m)
    return Poses(of, np.zeros(len(of)), place_m)


def _voted(mine_m: Floats, target_m: Floats, reach_m: float) -> Array:
    """(k, 2) displacements that most pairs of points agree on."""
    grown = np.array([reach_m, reach_m, LEVEL_M])
    low, high = mine_m.min(axis=0) - grown, mine_m.max(axis=0) + grown
    near = target_m[((target_m >= low) & (target_m <= high)).all(axis=1)]
    near = near[:: max(1, len(near) // VOTERS)]
    way_m = near[:, None] - mine_m
    counts = (np.abs(way_m[..., 2]) < LEVEL_M) & ((way_m[..., :2] ** 2).sum(axis=-1) <= reach_m**2)
    half = int(reach_m / CELL_M) + 1
    x, y = np.floor(way_m[counts][:, :2] / CELL_M).astype(np.int64).T + half
    votes = np.bincount(x * 2 * half + y, minlength=4 * half * half)
    top = np.argsort(-votes, kind="stable")[:VOTES]
    top = top[votes[top] > 0]
    return (np.stack([top // (2 * half), top % (2 * half)], axis=1) - half + 0.5) * CELL_M


def best_starts(groups: Groups, tree: cKDTree, poses: Poses) -> Poses:
    """Of each group its first hypothesis and the best of the others."""
    off_m = nearest_m(groups, tree, poses)
    off_m[np.flatnonzero(np.diff(poses.group, prepend=-1))] = -1
    order = np.lexsort((off_m, poses.group))
    rank = np.arange(len(order)) - np.searchsorted(poses.group, poses.group)
    return poses[np.sort(order[rank <= STARTS])]


def nearest_m(groups: Groups, tree: cKDTree, poses: Poses) -> Floats:
    """(h,) mean distance of each hypothesis' points to their nearest point of the other sweep."""
    item, _, place_m = posed(groups, poses)
    distance = np.minimum(tree.query(place_m, distance_upper_bound=CAP_M)[0], CAP_M)
    return np.bincount(item, distance, len(poses.group)) / np.maximum(groups.size[poses.group], 1)


def icp(groups: Groups, tree: cKDTree, poses: Poses, radii_m: tuple[float, ...]) -> Poses:
    """Move each hypothesis to its own optimum: point-to-point ICP about the vertical.

    Args:
        groups: Points to move.
        tree: Points of the other sweep.
        poses: Where to begin.
        radii_m: Pairs further apart are left out, step by step.

    Besl and McKay, A Method for Registration of 3-D Shapes, PAMI 1992.
    """
    yaw_rad, place_m = poses.yaw_rad.copy(), poses.place_m.copy()
    active = np.arange(len(poses.group))
    for radius_m in radii_m:
        if not len(active):
            break
        now = Poses(poses.group[active], yaw_rad[active], place_m[active])
        found, yaw, place = _step(groups, tree, now, radius_m)
        moved = active[found]
        change = np.abs(place - place_m[moved]).max(axis=1, initial=0) + np.abs(yaw - yaw_rad[moved])
        yaw_rad[moved], place_m[moved] = yaw, place
        active = moved[(change > CLOSE) | (radius_m > radii_m[-1])]
    return Poses(poses.group, yaw_rad, place_m)


def _step(groups: Groups, tree: cKDTree, poses: Poses, radius_m: float) -> tuple[Array, Floats, Floats]:
    """Which hypotheses found enough pairs, and the yaws and places that fit these best."""
    item, point, place_m = posed(groups, poses)
    distance, partner = tree.query(place_m, distance_upper_bound=radius_m)
    paired = np.isfinite(distance)
    item, total = item[paired], len(poses.group)
    local_m = groups.xyz_m[point[paired]] - groups.centre_m[poses.group][item]
    return _fit(local_m, tree.data[partner[paired]], item, total)


def _fit(local_m: Floats, goal_m: Floats, item: Ints, total: int) -> tuple[Array, Floats, Floats]:
    """Least squares yaw and place of each item from its pairs; as `registration.fit_yaw`, for all at once."""
    count = np.bincount(item, minlength=total)
    share = np.maximum(count, 1)[:, None]
    middle, goal = sums(item, local_m, total) / share, sums(item, goal_m, total) / share
    x, y, _ = (local_m - middle[item]).T
    u, v, _ = (goal_m - goal[item]).T
    yaw = np.arctan2(np.bincount(item, x * v - y * u, total), np.bincount(item, x * u + y * v, total))
    cos, sin = np.cos(yaw), np.sin(yaw)
    back = np.stack(
        [cos * middle[:, 0] - sin * middle[:, 1], sin * middle[:, 0] + cos * middle[:, 1], middle[:, 2]],
        axis=1,
    )
    found = np.flatnonzero(count >= MIN_PAIRS)
    return found, yaw[found], (goal - back)[found]
