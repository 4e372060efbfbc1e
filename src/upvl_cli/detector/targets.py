"""What each place has to say: which stand for a box by rotated overlap, which for nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from upvl_cli.detector.head import RESIDUAL, Assigned, Head, encode
from upvl_cli.geometry.iou import iou_bev_pairs
from upvl_cli.types import Array, Floats, Ints

# Overlap from which a place stands for a box, and below which it stands for nothing; between them it does not
# matter. Far lower than PointPillars' 0.6 and 0.45 for cars: the boxes are of all classes, sizes and headings,
# and from 0.5 and 0.35 down a training of the same length gained a quarter of its AP (docs/log.md).
POSITIVE_IOU = 0.35
NEGATIVE_IOU = 0.25
_PAIRS_A_BLOCK = 2**14  # their arrays stay in the cache


@dataclass(frozen=True)
class Targets:
    """What the places of a batch have to say.

    Attributes:
        weight: (b, k) how much the objectness of each place counts.
        sample: (p,) which sample each place that stands for a box belongs to.
        place: (p,) which place that is.
        residual: (p, RESIDUAL) float32 what it says of its box.
    """

    weight: Tensor
    sample: Tensor
    place: Tensor
    residual: Tensor

    def to(self, device: torch.device | str) -> Targets:
        """The same on another device."""
        return Targets(*(t.to(device) for t in (self.weight, self.sample, self.place, self.residual)))


def targets(head: Head, boxes: Sequence[Tensor]) -> Targets:
    """What the places have to say of the (m, 7) boxes of each sample."""
    return joined([_alone(head, some.numpy()) for some in boxes])


def joined(batches: Sequence[Targets]) -> Targets:
    """What they have to say of batches side by side."""
    before = np.cumsum([0, *(len(batch.weight) for batch in batches)]).tolist()
    return Targets(
        torch.cat([batch.weight for batch in batches]),
        torch.cat([batch.sample + samples for batch, samples in zip(batches, before, strict=False)]),
        torch.cat([batch.place for batch in batches]),
        torch.cat([batch.residual for batch in batches]),
    )


def _alone(head: Head, boxes: Array) -> Targets:
    given = head.assign(boxes)
    said = encode(head, head.places[given.place], boxes[given.box])
    return Targets(
        torch.from_numpy(given.weight)[None],
        torch.zeros(len(given.place), dtype=torch.int64),
        torch.from_numpy(given.place),
        torch.from_numpy(said.reshape(-1, RESIDUAL).astype(np.float32)),
    )


def assign(anchors: Floats, boxes: Array) -> Assigned:
    """Which anchors stand for which boxes, by bird's-eye overlap.

    An anchor takes the box that it overlaps most, if by `POSITIVE_IOU`. Each box takes the anchor that
    overlaps it most (the nearest one where none does) whatever its overlap; of two boxes that take the same
    anchor, the later one has it.

    Args:
        anchors: (k, 7) by ascending x.
        boxes: (m, 7).
    """
    most, owner = np.zeros(len(anchors)), np.full(len(anchors), -1)
    own = np.full(len(boxes), -1)
    for number, (near, iou) in enumerate(_Places(anchors).overlaps(boxes)):
        own[number] = near[iou.argmax()]
        better = iou > most[near]
        most[near[better]] = iou[better]
        owner[near[better]] = number
    weight = (most < NEGATIVE_IOU).astype(np.float32)
    owner[most < POSITIVE_IOU] = -1
    owner[own] = np.arange(len(boxes))
    place = np.flatnonzero(owner >= 0)
    weight[place] = 1
    return Assigned(weight, place, owner[place])


class _Places:
    """Anchors, with what tells quickly that they cannot overlap a box by much."""

    def __init__(self, anchors: Floats) -> None:
        self.anchors = anchors
        self.x, self.y, _, self.length, self.width, _, heading = np.ascontiguousarray(anchors.T)
        self.cos, self.sin = np.cos(heading), np.sin(heading)
        self.radius = np.hypot(self.length, self.width) / 2
        self.farthest = self.radius.max(initial=0)

    def overlaps(self, boxes: Array) -> Iterator[tuple[Ints, Floats]]:
        """For each of (m, 7) boxes some anchors, ascending, and their overlap with it.

        The best one is there, and all that overlap by `NEGATIVE_IOU`; the nearest one where none does.
        """
        near = [self._near(box) for box in boxes]
        for some in _blocks([len(of) for of in near]):
            count = [len(near[number]) for number in some]
            rows, of_box = np.concatenate([near[number] for number in some]), np.repeat(some, count)
            at_most = self._at_most(rows, boxes[of_box])
            good = at_most >= NEGATIVE_IOU
            iou = np.asarray(iou_bev_pairs(self.anchors[rows[good]], boxes[of_box[good]]))
            first = np.searchsorted(of_box[good], [*some, some[-1] + 1])
            start = np.cumsum([0, *count])
            for place, number in enumerate(some):
                mine = slice(first[place], first[place + 1])
                if (iou[mine] >= NEGATIVE_IOU).any():
                    yield rows[good][mine], iou[mine]
                else:
                    yield self._best(boxes[number], near[number], at_most[start[place] : start[place + 1]])

    def _best(self, box: Floats, near: Ints, at_most: Floats) -> tuple[Ints, Floats]:
        """The anchors that overlap a box most, where none does by `NEGATIVE_IOU`."""
        least = NEGATIVE_IOU
        while least > 0:
            least = least / 4 if least > 1e-3 else 0.0
            rows = near[at_most >= least]
            iou = np.asarray(iou_bev_pairs(self.anchors[rows], np.repeat(box[None], len(rows), axis=0)))
            if iou.max(initial=0) >= max(least, 1e-12):
                return rows, iou
        nearest = (np.square(self.x - box[0]) + np.square(self.y - box[1])).argmin()
        return np.array([nearest]), np.zeros(1)

    def _near(self, box: Floats) -> Ints:
        """The anchors whose circle touches that of a box, nearly."""
        radius = np.hypot(box[3], box[4]) / 2
        first, last = np.searchsorted(
            self.x, [box[0] - radius - self.farthest, box[0] + radius + self.farthest]
        )
        strip = slice(first, last)
        bound = self.radius[strip] + radius
        touches = np.abs(self.y[strip] - box[1]) <= bound
        touches &= np.abs(self.x[strip] - box[0]) <= bound
        return np.asarray(first + np.flatnonzero(touches))

    def _at_most(self, near: Ints, boxes: Floats) -> Floats:
        """(r,) overlaps that each anchor cannot exceed with the box of its row, (r, 7).

        Two rectangles share no more than their bounding boxes do, in the axes of the grid as in those of one of
        them, and no more than the smaller one has.
        """
        x, y, _, along, across, _, heading = boxes.T
        dx, dy = self.x[near] - x, self.y[near] - y
        cos, sin = self.cos[near], self.sin[near]
        length, width = self.length[near], self.width[near]
        box_cos, box_sin = np.cos(heading), np.sin(heading)
        size, box_size = length * width, along * across
        upright = _shared(
            dx, _reach(length, width, cos, sin), _reach(along, across, box_cos, box_sin)
        ) * _shared(dy, _reach(length, width, sin, cos), _reach(along, across, box_sin, box_cos))
        turned_cos, turned_sin = cos * box_cos + sin * box_sin, sin * box_cos - cos * box_sin
        turned = _shared(
            dx * box_cos + dy * box_sin, _reach(length, width, turned_cos, turned_sin), along / 2
        ) * _shared(dy * box_cos - dx * box_sin, _reach(length, width, turned_sin, turned_cos), across / 2)
        area = np.minimum(np.minimum(upright, turned), np.minimum(size, box_size))
        with np.errstate(invalid="ignore"):  # boxes without an area overlap nothing
            return np.asarray(np.nan_to_num(area / (size + box_size - area)) * (1 + 1e-9) + 1e-12)


def _blocks(counts: list[int]) -> Iterator[Ints]:
    """Numbers of boxes, in order, some at a time: as many as share `_PAIRS_A_BLOCK` pairs."""
    block = np.cumsum(counts) // _PAIRS_A_BLOCK
    return (np.flatnonzero(block == number) for number in np.unique(block))


def _reach(length: Array, width: Array, cos: Array, sin: Array) -> Floats:
    """How far a rectangle reaches from its middle along an axis at an angle to it."""
    return np.asarray((np.abs(cos) * length + np.abs(sin) * width) / 2)


def _shared(distance: Array, reach: Array, other: Array) -> Floats:
    """Length that two stretches of an axis share, from the distance of their middles."""
    most = 2 * np.minimum(reach, other)
    return np.asarray(np.clip(reach + other - np.abs(distance), 0, most))
