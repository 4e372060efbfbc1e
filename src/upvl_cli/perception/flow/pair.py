"""Two sweeps and the motion between them as far as it is known; the search for more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.flow.groups import Groups, Poses, centres, sample, turned
from upvl_cli.perception.flow.motion import best_starts, icp, starts
from upvl_cli.perception.flow.surface import Surface, misfit, surface, tree_of, witnesses
from upvl_cli.types import Bools, Floats, Ints

SEARCH = 80  # points of a group that look for its motion,
REFINE = 200  # and that make it exact
SEARCH_RADII_M = (1.0, 0.6, 0.4, 0.3, 0.3)
REFINE_RADII_M = (0.3, 0.2, 0.2)
RISE_M, SLOPE = 0.1, 0.2  # what stands on the ground rises no more than this, and this share of its way
WITNESSES = 0.2  # share of points that must tell a motion; the side of a wall has none
FAR_MISFIT = 0.1  # what a metre of motion must gain: of two places that fit alike, the nearer is likelier


@dataclass(frozen=True)
class Pair:
    """Two sweeps, the motion of the first one's points (written in place), and what a motion must keep.

    Attributes:
        source_m: (n, 3) points of the first sweep.
        target_m: (m, 3) points of the second, in the same axes.
        source_tree: The first sweep's.
        tree: The second sweep's.
        shift_m: (n, 3) how far each point has moved.
        yaw_rad: (n,) how far what it belongs to has turned.
        reach_m: No motion is longer.
        still_misfit: What lies this close to the other sweep, in spacings, stands still.
        min_gain: Motion must lower the misfit by this share.
    """

    source_m: Floats
    target_m: Floats
    source_tree: cKDTree
    tree: cKDTree
    shift_m: Floats
    yaw_rad: Floats
    reach_m: float
    still_misfit: float
    min_gain: float

    def poses(self, point: Ints, group: Ints, groups: Groups) -> Poses:
        """Where the motion so far puts groups.

        Args:
            point: (k,) points of the source.
            group: (k,) group of each.
            groups: Samples of these groups.
        """
        mean = centres(np.column_stack([self.shift_m, self.yaw_rad])[point], group, len(groups.size))
        return Poses(np.arange(len(mean)), mean[:, 3], groups.centre_m + mean[:, :3])

    def move(self, point: Ints, group: Ints, chosen: Bools, groups: Groups, poses: Poses) -> None:
        """Let the chosen groups' points move with their group.

        Args:
            point: (k,) points of the source.
            group: (k,) group of each, -1 for none.
            chosen: (g,) which groups.
            groups: Samples of the groups.
            poses: The pose of each group.
        """
        kept = (group >= 0) & chosen[group]
        point, group = point[kept], group[kept]
        here_m = self.source_m[point]
        local_m = here_m - groups.centre_m[group]
        self.shift_m[point] = turned(poses.yaw_rad[group], local_m) + poses.place_m[group] - here_m
        self.yaw_rad[point] = poses.yaw_rad[group]

    def seen(self, point: Ints, group: Ints, total: int, most: int) -> Surface:
        """A sample of each group, with the surface around its points.

        Args:
            point: (k,) points of the source.
            group: (k,) group of each, -1 for none.
            total: How many groups there are.
            most: Points to take of each at most.
        """
        return surface(sample(self.source_m[point], group, total=total, most=most), self.source_tree)


def likeliest(
    pair: Pair, point: Ints, group: Ints, free_m: Floats, of_free: Ints, total: int
) -> tuple[Surface, Poses, Floats]:
    """The likeliest pose of each group among other points, whether it has moved or not.

    Args:
        pair: The sweeps.
        point: (k,) points of the first sweep.
        group: (k,) group of each, -1 for none.
        free_m: (m, 3) points of the second that groups may have become.
        of_free: (m,) the group that each lies close to, -1 for none.
        total: How many groups there are.

    Returns:
        The points that judged, the poses, and what these cost: their misfit, and more for farther ones.
    """
    tree = tree_of(free_m)
    points = pair.seen(point, group, total, SEARCH)
    own_m = centres(free_m, of_free, total)
    poses = best_starts(points.groups, tree, starts(points.groups, free_m, own_m, pair.reach_m))
    poses = icp(points, tree, poses, SEARCH_RADII_M)
    cost = _cost(points, tree, poses)
    too_far = np.linalg.norm(_way_m(points.groups, poses), axis=1) > pair.reach_m
    order = np.lexsort((np.where(too_far, np.inf, cost), poses.group))
    poses = poses[order[np.flatnonzero(np.diff(poses.group[order], prepend=-1))]]
    points = pair.seen(point, group, total, REFINE)
    poses = icp(points, tree, poses, REFINE_RADII_M)
    return points, poses, _cost(points, tree, poses)


def _cost(points: Surface, tree: cKDTree, poses: Poses) -> Floats:
    """(h,) misfit of hypotheses, and what their length costs; infinite for those that cannot be."""
    x, y, z = _way_m(points.groups, poses).T
    cost = misfit(points, tree, poses) + FAR_MISFIT * np.sqrt(x * x + y * y + z * z)
    rises = np.abs(z) > RISE_M + SLOPE * np.hypot(x, y)
    return np.where(rises | (witnesses(points, poses) < WITNESSES), np.inf, cost)


def _way_m(groups: Groups, poses: Poses) -> Floats:
    """(h, 3) how far hypotheses move the centres of their groups."""
    return poses.place_m - groups.centre_m[poses.group]
