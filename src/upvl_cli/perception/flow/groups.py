"""Points in groups, handled all at once: what a loop over groups would do, without the loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Floats, Ints


class Groups(NamedTuple):
    """Points in order of their group.

    Attributes:
        xyz_m: (n, 3) points; those of a group lie together.
        first: (g,) where each group begins.
        size: (g,) points of each group.
        centre_m: (g, 3) mean of all points of each group, those that were not taken included.
    """

    xyz_m: Floats
    first: Ints
    size: Ints
    centre_m: Floats


@dataclass(frozen=True)
class Poses:
    """Where h hypotheses put the centres of their groups, and how they turn them about the vertical.

    Attributes:
        group: (h,) which group each is about.
        yaw_rad: (h,) angles, counter-clockwise.
        place_m: (h, 3) places of the centres.
    """

    group: Ints
    yaw_rad: Floats
    place_m: Floats

    def __getitem__(self, index: Array) -> Poses:
        """The hypotheses of that mask or those numbers."""
        return Poses(self.group[index], self.yaw_rad[index], self.place_m[index])


def still(groups: Groups) -> Poses:
    """The hypothesis that each group stands still."""
    total = len(groups.size)
    return Poses(np.arange(total), np.zeros(total), groups.centre_m)


def sample(xyz_m: Floats, of_point: Ints, *, total: int, most: int) -> Groups:
    """Take points of each group, evenly from their order.

    Args:
        xyz_m: (n, 3) points.
        of_point: (n,) group of each, below `total`; -1 where it has none.
        total: How many groups there are.
        most: Points to take of each at most.
    """
    order = np.argsort(of_point, kind="stable")
    order = order[np.searchsorted(of_point[order], 0) :]
    group = of_point[order]
    size = np.bincount(group, minlength=total)
    rank = np.arange(len(order)) - (np.cumsum(size) - size)[group]
    step = np.minimum(size, most)[group]
    # Every time that rank x step passes a multiple of the size, one point is taken.
    taken = rank * step // size[group] != (rank - 1) * step // size[group]
    centre_m = centres(xyz_m[order], group, total)
    size = np.minimum(size, most)
    return Groups(xyz_m[order[taken]], np.cumsum(size) - size, size, centre_m)


def sums(group: Ints, values: Array, total: int) -> Array:
    """(total, d) sum of the rows of values over each group."""
    columns = [np.bincount(group, column, total) for column in values.T]
    return np.stack(columns, axis=1).astype(np.float64)  # of nothing, bincount gives integers


def members(groups: Groups, group: Ints) -> tuple[Ints, Ints]:
    """The points of some groups, which may come twice.

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


def turned(yaw_rad: Floats, xyz_m: Floats) -> Floats:
    """(n, 3) points, each turned about the vertical by its own angle."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = xyz_m.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


def posed(groups: Groups, poses: Poses) -> tuple[Ints, Ints, Floats]:
    """The points of each hypothesis where it puts them: which hypothesis, which point, place (n, 3)."""
    item, point = members(groups, poses.group)
    local_m = groups.xyz_m[point] - groups.centre_m[poses.group][item]
    return item, point, turned(poses.yaw_rad[item], local_m) + poses.place_m[item]


def centres(values: Array, group: Ints, total: int) -> Floats:
    """(total, d) mean of the rows of values over each group, -1 being none; NaN where a group has no row."""
    held = group >= 0
    size = np.bincount(group[held], minlength=total)[:, None].astype(np.float64)
    size[size == 0] = np.nan
    return np.asarray(sums(group[held], values[held], total) / size)


def renumbered(label: Ints, kept: Ints) -> Ints:
    """Labels as places in `kept`, which ascends; -1 for all others."""
    if not len(kept):
        return np.full(len(label), -1)
    place = np.minimum(np.searchsorted(kept, label), len(kept) - 1)
    return np.where(kept[place] == label, place, -1)
