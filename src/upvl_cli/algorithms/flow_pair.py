"""Two sweeps and the motion between them as far as it is known; the search for more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.algorithms.flow_groups import Groups, Poses, centres, sample, turned
from upvl_cli.algorithms.flow_motion import best_starts, icp, starts
from upvl_cli.algorithms.flow_surface import Surface, misfit, surface, tree_of, witnesses
from upvl_cli.types import Bools, Floats, Ints

SEARCH = 80  # points of a group that look for its motion,
REFINE = 400  # and that make it exact
SEARCH_RADII_M = (1.0, 0.7, 0.5, 0.4, 0.3, 0.3, 0.3)
REFINE_RADII_M = (0.3, 0.2, 0.2)
WITNESSES = 0.2  # share of points that must tell a motion; the side of a wall has none
FAR_MISFIT = 0.1  # what a metre of motion must gain: of two places that fit alike, the nearer is likelier


@dataclass(frozen=True)
class Pair:
    """Two sweeps, the motion of the first one's points (written in place), and what a motion must keep.

    Attributes:
        source_m: (n, 3) points of the first sweep.
        target_m: (m, 3) points of the second, in the same axes.
        tree: The second sweep's.
        shift_m: (n, 3) how far each point has moved.
        yaw_rad: (n,) how far what it belongs to has turned.
        reach_m: No motion is longer.
        still_misfit: What lies this close to the other sweep, in spacings, stands still.
        min_gain: Motion must lower the misfit by this share.
    """

    source_m: Floats
    target_m: Floats
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


def seen(xyz_m: Floats, group: Ints, total: int, most: int) -> Surface:
    """A sample of each group, with the surface around its points: those of any group, -1 being none."""
    return surface(sample(xyz_m, group, total=total, most=most), xyz_m[group >= 0])


def likeliest(
    pair: Pair, xyz_m: Floats, group: Ints, free_m: Floats, of_free: Ints, total: int
) -> tuple[Surface, Poses, Floats]:
    """The likeliest pose of each group among other points, whether it has moved or not.

    Args:
        pair: The sweeps.
        xyz_m: (n, 3) points of the first sweep.
        group: (n,) group of each, -1 for none.
        free_m: (m, 3) points of the second that groups may have become.
        of_free: (m,) the group that each lies close to, -1 for none.
        total: How many groups there are.

    Returns:
        The points that judged, the poses, and what these cost: their misfit, and more for farther ones.
    """
    tree = tree_of(free_m)
    points = seen(xyz_m, group, total, SEARCH)
    own_m = centres(free_m, of_free, total)
    poses = best_starts(points.groups, tree, starts(points.groups, free_m, own_m, pair.reach_m))
    poses = icp(points, tree, poses, SEARCH_RADII_M)
    cost = _cost(points, tree, poses)
    way_m = _way_m(points.groups, poses)
    order = np.lexsort((np.where(way_m > pair.reach_m, np.inf, cost), poses.group))
    poses = poses[order[np.flatnonzero(np.diff(poses.group[order], prepend=-1))]]
    points = seen(xyz_m, group, total, REFINE)
    poses = icp(points, tree, poses, REFINE_RADII_M)
    return points, poses, _cost(points, tree, poses)


def _cost(points: Surface, tree: cKDTree, poses: Poses) -> Floats:
    """(h,) misfit of hypotheses, and what their length costs; infinite where too few points tell the motion."""
    cost = misfit(points, tree, poses) + FAR_MISFIT * _way_m(points.groups, poses)
    return np.where(witnesses(points, poses) < WITNESSES, np.inf, cost)


def _way_m(groups: Groups, poses: Poses) -> Floats:
    """(h,) how far hypotheses move the centres of their groups."""
    return np.asarray(np.linalg.norm(poses.place_m - groups.centre_m[poses.group], axis=1))
