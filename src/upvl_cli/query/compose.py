"""Questions about two objects, or about one over time: which is near another, overtakes it, or stops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.boxes import corners_bev, geometry_of
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints, ParallelArrays, array, concat

_MOST_PAIRS = 2**18  # compared at once: some 100 MB of corners
_MARGIN_M = 1.0  # from clearly behind to clearly ahead: centres of two that drive side by side jitter by less
_SAME_DIRECTION = np.cos(np.pi / 4)  # a wider angle is crossing traffic or a turn


@dataclass(frozen=True)
class TimedBoxes(Boxes):
    """Boxes of many frames, each in the ego axes of its frame.

    Attributes:
        frame: (n,) key of the frame; frames of different drives have different keys.
        time_s: (n,) time of the frame; comparable within one drive.
        object_id: (n,) key of the object, the same in all frames of it and in no other drive.
        velocity_mps: (n, 3) velocity over the ground along the ego axes.
    """

    frame: Array = array("int64")
    time_s: Array = array("float64")
    object_id: Array = array("int64")
    velocity_mps: Array = array("float64", 3)

    @property
    def speed_mps(self) -> Floats:
        """(n,) horizontal speed over the ground."""
        return np.asarray(np.hypot(self.velocity_mps[:, 0], self.velocity_mps[:, 1]))


@dataclass(frozen=True)
class Moments(ParallelArrays):
    """Moments at which a relation holds.

    Attributes:
        first: (n,) row of the box that the question is about.
        second: (n,) row of the other box; -1 where the relation has none.
        value: (n,) what was measured: a gap in metres, or a duration in seconds.
    """

    first: Array = array("int64")
    second: Array = array("int64")
    value: Array = array("float64")


def gap_m(first: Boxes, second: Boxes) -> Floats:
    """Return (n,) horizontal gap between the footprints of pairs of boxes in metres; 0 where they overlap.

    Two rectangles that do not overlap are nearest at a corner of one of them.

    Args:
        first: n boxes.
        second: n boxes, each the partner of one of the first.
    """
    gap = np.minimum(_from_corners(first, second), _from_corners(second, first))
    return np.asarray(np.where(_overlap(first, second), 0.0, gap))


def _from_corners(first: Boxes, second: Boxes) -> Floats:
    """Return (n,) smallest distance of a corner of the first from the footprint of the second."""
    relative = corners_bev(first) - second.center_m[:, None, :2]  # (n, 4, 2)
    cos, sin = np.cos(second.heading_rad)[:, None], np.sin(second.heading_rad)[:, None]
    along = relative[..., 0] * cos + relative[..., 1] * sin
    across = relative[..., 1] * cos - relative[..., 0] * sin
    half = second.size_lwh_m[:, None, :2] / 2
    outside = np.maximum(np.abs(np.stack([along, across], axis=-1)) - half, 0)
    return np.asarray(np.hypot(outside[..., 0], outside[..., 1]).min(axis=1, initial=np.inf))


def _overlap(first: Boxes, second: Boxes) -> Bools:
    """Return (n,) whether footprints overlap: none of the four directions of their sides separates them."""
    overlap = np.ones(len(first), dtype=np.bool_)
    corners = corners_bev(first), corners_bev(second)
    for heading in (first.heading_rad, second.heading_rad):
        for angle in (heading, heading + np.pi / 2):
            axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            a, b = (np.einsum("nkd,nd->nk", places, axis) for places in corners)
            overlap &= (a.max(axis=1) >= b.min(axis=1)) & (b.max(axis=1) >= a.min(axis=1))
    return overlap


def near(first: TimedBoxes, second: TimedBoxes, within_m: float) -> Moments:
    """Return for each first box that has a second one near it in the same frame the nearest of these.

    Args:
        first: Boxes that are looked for.
        second: Boxes that they are to be near; a box is not near its own object.
        within_m: Largest gap between the footprints.
    """
    parts = []
    for a, b in _pairs_of_frames(first, second):
        reach = within_m + _half_diagonal(first)[a] + _half_diagonal(second)[b]
        apart = np.hypot(*(first.center_m[a, :2] - second.center_m[b, :2]).T)
        close = np.flatnonzero((apart <= reach) & (first.object_id[a] != second.object_id[b]))
        gap = gap_m(geometry_of(first[a[close]]), geometry_of(second[b[close]]))
        kept = np.flatnonzero(gap <= within_m)
        parts.append(Moments(a[close][kept], b[close][kept], gap[kept]))
    return _lowest_of_each(concat(parts, Moments))


def overtakings(first: TimedBoxes, second: TimedBoxes, *, max_lateral_m: float, moving_mps: float) -> Moments:
    """Return for each pair in which the first overtakes the second the first box that is ahead, and the time it took.

    Both move in the same direction, and the centre of the first, seen along the direction of the second, goes from
    1 m behind to 1 m ahead while it is never farther to the side than `max_lateral_m`.

    Args:
        first: Boxes of objects that may overtake.
        second: Boxes of objects that may be overtaken.
        max_lateral_m: Largest distance of the centres across the direction of the second.
        moving_mps: Minimum speed of a moving box.
    """
    pairs = list(_pairs_of_frames(first, second))
    a, b = (np.concatenate([pair[side] for pair in pairs]) for side in (0, 1))
    usable = first.object_id[a] != second.object_id[b]
    usable &= (first.speed_mps[a] >= moving_mps) & (second.speed_mps[b] >= moving_mps)
    a, b = a[usable], b[usable]
    direction = second.velocity_mps[b, :2] / second.speed_mps[b][:, None]
    offset = first.center_m[a, :2] - second.center_m[b, :2]
    ahead_m = np.einsum("nd,nd->n", offset, direction)
    lateral_m = np.abs(offset[:, 1] * direction[:, 0] - offset[:, 0] * direction[:, 1])
    agreement = np.einsum("nd,nd->n", first.velocity_mps[a, :2], direction) / first.speed_mps[a]
    beside = (lateral_m <= max_lateral_m) & (agreement >= _SAME_DIRECTION)
    order = np.lexsort((first.time_s[a], second.object_id[b], first.object_id[a]))
    a, b, ahead_m, beside = a[order], b[order], ahead_m[order], beside[order]
    found: list[tuple[int, int, float]] = []
    new_pair = np.flatnonzero(
        (np.diff(first.object_id[a], prepend=-1) != 0) | (np.diff(second.object_id[b], prepend=-1) != 0)
    )
    for run in np.split(np.arange(len(a)), new_pair)[1:]:
        found += [(int(a[i]), int(b[i]), took) for i, took in _passes(run, ahead_m, beside, first.time_s[a])]
    rows = np.array(found, dtype=np.float64).reshape(-1, 3)
    return Moments(rows[:, 0], rows[:, 1], rows[:, 2])


def _passes(run: Ints, ahead_m: Floats, beside: Bools, time_s: Floats) -> Iterator[tuple[int, float]]:
    """Yield the place at which one pair is ahead after it was behind, and the seconds since then."""
    behind: int | None = None
    for place in run.tolist():
        if not beside[place]:
            behind = None
        elif ahead_m[place] <= -_MARGIN_M:
            behind = place
        elif ahead_m[place] >= _MARGIN_M and behind is not None:
            yield place, float(time_s[place] - time_s[behind])
            behind = None


def stops(boxes: TimedBoxes, *, min_stand_s: float, moving_mps: float) -> Moments:
    """Return for each stop of an object its first standing box, and how long it is seen standing.

    An object stops where a box that moves is followed by boxes that do not, for at least `min_stand_s`.

    Args:
        boxes: Boxes of objects, in any order.
        min_stand_s: Shortest time between the first and the last standing box.
        moving_mps: Minimum speed of a moving box.
    """
    order = np.lexsort((boxes.time_s, boxes.object_id))
    object_id, time_s = boxes.object_id[order], boxes.time_s[order]
    moves = boxes.speed_mps[order] >= moving_mps
    if not len(order):
        return Moments(order, order, time_s)
    changes = (np.diff(object_id) != 0) | (np.diff(moves.astype(np.int8)) != 0)
    begin = np.concatenate([[0], np.flatnonzero(changes) + 1])
    end = np.concatenate([begin[1:], [len(order)]]) - 1
    # The run before this one is of the same object, and so it moves where this one stands.
    follows = np.concatenate([[False], object_id[begin[1:]] == object_id[begin[1:] - 1]])
    duration_s = time_s[end] - time_s[begin]
    kept = follows & ~moves[begin] & (duration_s >= min_stand_s)
    return Moments(order[begin[kept]], np.full(int(kept.sum()), -1), duration_s[kept])


def _pairs_of_frames(first: TimedBoxes, second: TimedBoxes) -> Iterator[tuple[Ints, Ints]]:
    """Yield all pairs of rows of the same frame, some at a time."""
    by_frame = np.argsort(second.frame, kind="stable")
    frames = second.frame[by_frame]
    begin = np.searchsorted(frames, first.frame, side="left")
    count = np.searchsorted(frames, first.frame, side="right") - begin
    total = np.cumsum(count)
    parts = np.searchsorted(total, np.arange(_MOST_PAIRS, total[-1] if len(total) else 0, _MOST_PAIRS))
    for rows in np.split(np.arange(len(first)), np.unique(parts)):
        repeated = np.repeat(rows, count[rows])
        within_frame = np.arange(len(repeated)) - np.repeat(np.cumsum(count[rows]) - count[rows], count[rows])
        yield repeated, by_frame[begin[repeated] + within_frame]


def _half_diagonal(boxes: Boxes) -> Floats:
    return np.asarray(np.hypot(boxes.size_lwh_m[:, 0], boxes.size_lwh_m[:, 1]) / 2)


def _lowest_of_each(moments: Moments) -> Moments:
    """Return for each first box the moment of the lowest value, by ascending first box."""
    ordered = moments[np.lexsort((moments.second, moments.value, moments.first))]
    return ordered[np.unique(ordered.first, return_index=True)[1]]
