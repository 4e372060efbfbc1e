"""Which anchors stand for which boxes, by rotated overlap seen from above."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.iou import iou_bev_pairs
from upvl_cli.types import Array, Boxes, Floats, Ints

_PAIRS_PER_BLOCK = 2**14  # their arrays stay in the cache


@dataclass(frozen=True)
class Assignment:
    """What the anchors of one frame have to predict.

    Attributes:
        weight: (k,) weight of the objectness of each anchor: 1, less, or 0 where it is ignored.
        anchor: (p,) the positive anchors, ascending.
        box: (p,) the box of each of them.
    """

    weight: Floats
    anchor: Ints
    box: Ints


def assign_by_overlap(anchors: Boxes, boxes: Boxes, positive_iou: float, negative_iou: float) -> Assignment:
    """Return which anchors are positive, ignored or negative (PointPillars, Lang et al., CVPR 2019, Section 3.2).

    An anchor takes the box that it overlaps most, if by `positive_iou`. Each box takes the anchor that
    overlaps it most (the nearest one where none does) whatever its overlap; of two boxes that take the same
    anchor, the later one has it.

    Args:
        anchors: (k) anchors by ascending x.
        boxes: (m) boxes.
        positive_iou: Overlap from which an anchor is positive.
        negative_iou: Overlap below which an anchor is negative; between the two it is ignored.
    """
    highest, owner = np.zeros(len(anchors)), np.full(len(anchors), -1)
    best_anchor = np.full(len(boxes), -1)
    for number, (near, iou) in enumerate(_AnchorSearch(anchors, negative_iou).overlaps(boxes)):
        best_anchor[number] = near[iou.argmax()]
        better = iou > highest[near]
        highest[near[better]] = iou[better]
        owner[near[better]] = number
    weight = (highest < negative_iou).astype(np.float32)
    owner[highest < positive_iou] = -1
    owner[best_anchor] = np.arange(len(boxes))
    anchor = np.flatnonzero(owner >= 0)
    weight[anchor] = 1
    return Assignment(weight, anchor, owner[anchor])


class _AnchorSearch:
    """Anchors, with upper bounds that tell quickly which cannot overlap a box by much."""

    def __init__(self, anchors: Boxes, negative_iou: float) -> None:
        self.rows = anchors.to_rows()  # as a kernel: named parts would be checked anew for each block
        self.negative_iou = negative_iou
        self.x, self.y, _, self.length, self.width, _, heading = np.ascontiguousarray(self.rows.T)
        self.cos, self.sin = np.cos(heading), np.sin(heading)
        self.radius = np.hypot(self.length, self.width) / 2
        self.largest_radius = self.radius.max(initial=0)

    def overlaps(self, boxes: Boxes) -> Iterator[tuple[Ints, Floats]]:
        """Yield for each box some anchors, ascending, and their overlap with it.

        The best one is there, and all that overlap by `negative_iou`; the nearest one where none does.
        """
        rows = boxes.to_rows()
        near = [self._near(row) for row in rows]
        for block in _blocks([len(anchors) for anchors in near]):
            count = [len(near[number]) for number in block]
            anchors, of_box = np.concatenate([near[number] for number in block]), np.repeat(block, count)
            bound = self._upper_bound(anchors, rows[of_box])
            good = bound >= self.negative_iou
            iou = self._iou(anchors[good], rows[of_box[good]])
            first = np.searchsorted(of_box[good], [*block, block[-1] + 1])
            start = np.cumsum([0, *count])
            for index, number in enumerate(block):
                of_number = slice(first[index], first[index + 1])
                if (iou[of_number] >= self.negative_iou).any():
                    yield anchors[good][of_number], iou[of_number]
                else:
                    yield self._best(rows[number], near[number], bound[start[index] : start[index + 1]])

    def _iou(self, anchors: Ints, rows: Floats) -> Floats:
        return np.asarray(iou_bev_pairs(Boxes.from_rows(self.rows[anchors]), Boxes.from_rows(rows)))

    def _best(self, row: Floats, near: Ints, bound: Floats) -> tuple[Ints, Floats]:
        """Return the anchors that overlap a box most, where none does by `negative_iou`."""
        threshold = self.negative_iou
        while threshold > 0:
            threshold = threshold / 4 if threshold > 1e-3 else 0.0
            anchors = near[bound >= threshold]
            iou = self._iou(anchors, np.repeat(row[None], len(anchors), axis=0))
            if iou.max(initial=0) >= max(threshold, 1e-12):
                return anchors, iou
        nearest = (np.square(self.x - row[0]) + np.square(self.y - row[1])).argmin()
        return np.array([nearest]), np.zeros(1)

    def _near(self, row: Floats) -> Ints:
        """Return the anchors whose circumscribed square touches that of a box."""
        x, y, _, length, width, _, _ = row
        radius = np.hypot(length, width) / 2
        first, last = np.searchsorted(
            self.x, [x - radius - self.largest_radius, x + radius + self.largest_radius]
        )
        strip = slice(first, last)
        reach = self.radius[strip] + radius
        touches = np.abs(self.y[strip] - y) <= reach
        touches &= np.abs(self.x[strip] - x) <= reach
        return np.asarray(first + np.flatnonzero(touches))

    def _upper_bound(self, near: Ints, rows: Floats) -> Floats:
        """Return (r,) overlaps that each anchor cannot exceed with the box of its row, (r, 7).

        Two rectangles share no more than their bounding boxes do, in the axes of the grid as in those of one of
        them, and no more than the smaller one has.
        """
        x, y, _, box_length, box_width, _, heading = rows.T
        dx, dy = self.x[near] - x, self.y[near] - y
        cos, sin = self.cos[near], self.sin[near]
        length, width = self.length[near], self.width[near]
        box_cos, box_sin = np.cos(heading), np.sin(heading)
        area, box_area = length * width, box_length * box_width
        in_grid_axes = _common_length(
            dx, _half_extent(length, width, cos, sin), _half_extent(box_length, box_width, box_cos, box_sin)
        ) * _common_length(
            dy, _half_extent(length, width, sin, cos), _half_extent(box_length, box_width, box_sin, box_cos)
        )
        turned_cos, turned_sin = cos * box_cos + sin * box_sin, sin * box_cos - cos * box_sin
        in_box_axes = _common_length(
            dx * box_cos + dy * box_sin, _half_extent(length, width, turned_cos, turned_sin), box_length / 2
        ) * _common_length(
            dy * box_cos - dx * box_sin, _half_extent(length, width, turned_sin, turned_cos), box_width / 2
        )
        common = np.minimum(np.minimum(in_grid_axes, in_box_axes), np.minimum(area, box_area))
        with np.errstate(invalid="ignore"):  # boxes without an area overlap nothing
            return np.asarray(np.nan_to_num(common / (area + box_area - common)) * (1 + 1e-9) + 1e-12)


def _blocks(counts: list[int]) -> Iterator[Ints]:
    """Return the numbers of boxes, in order, in blocks of about `_PAIRS_PER_BLOCK` pairs."""
    block = np.cumsum(counts) // _PAIRS_PER_BLOCK
    return (np.flatnonzero(block == number) for number in np.unique(block))


def _half_extent(length: Array, width: Array, cos: Array, sin: Array) -> Floats:
    """Return half the extent of a rectangle along an axis at an angle to it."""
    return np.asarray((np.abs(cos) * length + np.abs(sin) * width) / 2)


def _common_length(distance: Array, half_extent: Array, half_extent_b: Array) -> Floats:
    """Return the length that two intervals share, from the distance of their middles."""
    longest = 2 * np.minimum(half_extent, half_extent_b)
    return np.asarray(np.clip(half_extent + half_extent_b - np.abs(distance), 0, longest))
