"""Point sets in groups, processed all at once: what a loop over groups computes, without the loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Floats, Ints


class Groups(NamedTuple):
    """Points in order of their group.

    Attributes:
        xyz_m: (n, 3) points; those of a group are consecutive rows.
        first: (g,) row at which each group begins.
        size: (g,) points of each group.
        center_m: (g, 3) mean of all points of each group, those that were not sampled included.
    """

    xyz_m: Floats
    first: Ints
    size: Ints
    center_m: Floats


@dataclass(frozen=True)
class Poses:
    """Hypotheses of where groups have moved, each a position of the center and a turn about the vertical.

    Attributes:
        group: (h,) group that each hypothesis is about.
        yaw_rad: (h,) angles, counter-clockwise.
        center_m: (h, 3) positions of the centers.
    """

    group: Ints
    yaw_rad: Floats
    center_m: Floats

    def __getitem__(self, index: Array) -> Poses:
        """Return the hypotheses that a mask or an array of numbers selects."""
        return Poses(self.group[index], self.yaw_rad[index], self.center_m[index])


def static_poses(groups: Groups) -> Poses:
    """Return one hypothesis for each group: that it has not moved."""
    total = len(groups.size)
    return Poses(np.arange(total), np.zeros(total), groups.center_m)


def sample_groups(xyz_m: Floats, group_of_point: Ints, *, total: int, max_points: int) -> Groups:
    """Sample points of each group, evenly from their order.

    Args:
        xyz_m: (n, 3) points.
        group_of_point: (n,) group of each, below `total`; -1 where it has none.
        total: Number of groups.
        max_points: Points that are sampled from each at most.
    """
    order = np.argsort(group_of_point, kind="stable")
    order = order[np.searchsorted(group_of_point[order], 0) :]
    group = group_of_point[order]
    size = np.bincount(group, minlength=total)
    rank = np.arange(len(order)) - (np.cumsum(size) - size)[group]
    step = np.minimum(size, max_points)[group]
    # Every time that rank x step passes a multiple of the size, one point is sampled.
    sampled = rank * step // size[group] != (rank - 1) * step // size[group]
    center_m = group_means(xyz_m[order], group, total)
    size = np.minimum(size, max_points)
    return Groups(xyz_m[order[sampled]], np.cumsum(size) - size, size, center_m)


def select_groups(groups: Groups, kept: Ints) -> Groups:
    """Return some of the groups, numbered by their place in `kept`.

    Args:
        groups: The groups.
        kept: (k,) numbers of groups.
    """
    _, point = group_members(groups, kept)
    size = groups.size[kept]
    return Groups(groups.xyz_m[point], np.cumsum(size) - size, size, groups.center_m[kept])


def group_sums(values: Array, group: Ints, total: int) -> Array:
    """Return the (total, d) sums of the rows of (n, d) values over each group."""
    columns = [np.bincount(group, column, total) for column in values.T]
    return np.stack(columns, axis=1).astype(np.float64)  # of nothing, bincount gives integers


def group_means(values: Array, group: Ints, total: int) -> Floats:
    """Return the (total, d) means of the rows of values over each group; NaN where a group has no row.

    Args:
        values: (n, d) rows.
        group: (n,) group of each row, -1 for none.
        total: Number of groups.
    """
    grouped = group >= 0
    size = np.bincount(group[grouped], minlength=total)[:, None].astype(np.float64)
    size[size == 0] = np.nan
    return np.asarray(group_sums(values[grouped], group[grouped], total) / size)


def group_members(groups: Groups, group: Ints) -> tuple[Ints, Ints]:
    """Return the points of a list of groups, in which a group may come twice.

    Args:
        groups: The points.
        group: (h,) numbers of groups.

    Returns:
        For each point of the first group, then of the second...: which item of `group`, which point.
    """
    size = groups.size[group]
    item = np.repeat(np.arange(len(group)), size)
    begin = np.cumsum(size) - size
    return item, np.arange(len(item)) + (groups.first[group] - begin)[item]


def rotate_about_z(yaw_rad: Floats, xyz_m: Floats) -> Floats:
    """Return (n, 3) points or vectors, each rotated about the vertical by its own (n,) angle."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = xyz_m.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


def apply_poses(groups: Groups, poses: Poses) -> tuple[Ints, Ints, Floats]:
    """Transform the points of each hypothesis' group by it.

    Args:
        groups: The points.
        poses: h hypotheses.

    Returns:
        For each transformed point: which hypothesis, which point of `groups`, and its (n, 3) position.
    """
    item, point = group_members(groups, poses.group)
    local_m = groups.xyz_m[point] - groups.center_m[poses.group][item]
    if not poses.yaw_rad.any():
        return item, point, local_m + poses.center_m[item]
    return item, point, rotate_about_z(poses.yaw_rad[item], local_m) + poses.center_m[item]


def relabel(label: Ints, kept: Ints) -> Ints:
    """Return labels as their index in `kept`, which ascends; -1 for labels that are not in it.

    Args:
        label: (n,) labels.
        kept: (k,) labels that stay.
    """
    place = np.full(int(max(label.max(initial=-1), kept.max(initial=-1))) + 2, -1)  # the last is that of -1
    place[kept] = np.arange(len(kept))
    return place[label]
