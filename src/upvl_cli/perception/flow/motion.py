"""Where groups of points went: starts by a vote over displacements, then ICP, all groups together."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.groups import Groups, Poses, posed, turned
from upvl_cli.perception.flow.surface import Surface
from upvl_cli.types import Array, Floats, Ints

VOTERS = 300  # points of the other sweep that vote for one group
CELL_M = 0.3  # of the vote
RISE_M = 0.2  # pairs that differ more in height do not vote
VOTES = 3  # best cells that become starts
STARTS = 2  # best starts that are followed, besides standing still
CAP_M = 0.5  # a point without partner counts as this far off
MIN_PAIRS = 5  # fewer fix no motion
ALONG = 0.2  # weight of a flat patch along itself; across it is 1
LEVEL = 0.1  # weight of staying at the same height, against the pairs: what stands on the ground hardly rises
RIDGE = 1e-6  # keeps what nothing fixes (the turn of a pole) where it is
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
    grown = np.array([reach_m, reach_m, RISE_M])
    low, high = mine_m.min(axis=0) - grown, mine_m.max(axis=0) + grown
    x, y, z = target_m.T
    near = target_m[
        (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2])
    ]
    near = near[:: max(1, len(near) // VOTERS)]
    x, y, z = (there[:, None] - here for there, here in zip(near.T, mine_m.T, strict=True))
    counts = (np.abs(z) < RISE_M) & (x * x + y * y <= reach_m**2)
    half = int(reach_m / CELL_M) + 1
    x, y = (np.floor(way[counts] / CELL_M).astype(np.int64) + half for way in (x, y))
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


def icp(surface: Surface, tree: cKDTree, poses: Poses, radii_m: tuple[float, ...]) -> Poses:
    """Move each hypothesis to its own optimum: ICP about the vertical, from patch to point.

    A flat patch counts fully across, and by `ALONG` along itself: the rows of a scan, which lie
    elsewhere on a surface in each sweep, must not draw each other.

    Args:
        surface: Points to move and what is known around them.
        tree: Points of the other sweep.
        poses: Where to begin.
        radii_m: Pairs further apart are left out, step by step.

    Segal et al., Generalized-ICP, RSS 2009, with the covariance of one side only.
    """
    yaw_rad, place_m = poses.yaw_rad.copy(), poses.place_m.copy()
    active = np.arange(len(poses.group))
    for radius_m in radii_m:
        if not len(active):
            break
        now = Poses(poses.group[active], yaw_rad[active], place_m[active])
        found, yaw, shift = _step(surface, tree, now, radius_m)
        moved = active[found]
        yaw_rad[moved] += yaw
        place_m[moved] += shift
        change = np.abs(shift).max(axis=1, initial=0) + np.abs(yaw)
        active = moved[(change > CLOSE) | (radius_m > radii_m[-1])]
    return Poses(poses.group, yaw_rad, place_m)


def _step(surface: Surface, tree: cKDTree, poses: Poses, radius_m: float) -> tuple[Ints, Floats, Floats]:
    """Which hypotheses found enough pairs, and the turn and shift that bring these closer."""
    item, point, place_m = posed(surface.groups, poses)
    distance, partner = tree.query(place_m, distance_upper_bound=radius_m)
    paired = np.isfinite(distance)
    item, point, place_m = item[paired], point[paired], place_m[paired]
    way_m = tree.data[partner[paired]] - place_m
    total = len(poses.group)
    count = np.bincount(item, minlength=total)
    system = _normal_equations(
        surface, point, poses.yaw_rad, place_m - poses.place_m[item], way_m, item, total
    )
    rise_m = poses.place_m[:, 2] - surface.groups.centre_m[poses.group, 2]
    system[:, 3, 3] += LEVEL * count
    system[:, 3, 4] -= LEVEL * count * rise_m
    found = np.flatnonzero(count >= MIN_PAIRS)
    system = system[found]
    ridge = RIDGE * np.trace(system[:, :, :4], axis1=1, axis2=2)[:, None, None] * np.eye(4)
    step = np.linalg.solve(system[:, :, :4] + ridge, system[:, :, 4:])[..., 0]
    return found, step[:, 0], step[:, 1:]


def _normal_equations(
    surface: Surface, point: Ints, yaw_rad: Floats, arm_m: Floats, way_m: Floats, item: Ints, total: int
) -> Floats:
    """(total, 4, 5) least squares of turn, x, y and z, and their right sides.

    Args:
        surface: What is known around the points.
        point: (n,) the points that have a partner.
        yaw_rad: (total,) how far each item has turned.
        arm_m: (n, 3) from the centre of its item to each point.
        way_m: (n, 3) from each point to its partner.
        item: (n,) the item of each.
        total: How many items there are.
    """
    (ax, ay, _), (wx, wy, wz) = arm_m.T, way_m.T
    nx, ny, nz = turned(yaw_rad[item], surface.normal[point]).T
    flat = surface.flat[point]
    along, across = np.where(flat, ALONG, 1.0), np.where(flat, 1 - ALONG, 0.0)
    # How turn, x, y, z and the way itself show across the patch, and their products in full.
    seen = (ax * ny - ay * nx, nx, ny, nz, nx * wx + ny * wy + nz * wz)
    full = {
        (0, 0): ax * ax + ay * ay, (0, 1): -ay, (0, 2): ax, (0, 4): ax * wy - ay * wx,
        (1, 1): 1.0, (2, 2): 1.0, (3, 3): 1.0, (1, 4): wx, (2, 4): wy, (3, 4): wz,
    }  # fmt: skip
    system = np.zeros((total, 5, 5))
    for i in range(4):
        for j in range(i, 5):
            product = across * seen[i] * seen[j] + along * full.get((i, j), 0.0)
            system[:, i, j] = system[:, j, i] = np.bincount(item, product, total)
    return system[:, :4]
