"""What each place has to say: which stand for a box by rotated overlap, which for nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from upvl_cli.detector.head import RESIDUAL, Assigned, Head, encode
from upvl_cli.geometry.iou import iou_bev_pairs
from upvl_cli.types import Array, Floats, Ints

# Overlap from which a place stands for a box, and below which it stands for nothing; between them it does not
# matter. Lower than PointPillars' 0.6 and 0.45 for cars: the boxes are of all classes, sizes and headings.
POSITIVE_IOU = 0.5
NEGATIVE_IOU = 0.35


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
    each = [head.assign(some.numpy()) for some in boxes]
    said = [encode(head, head.places[a.place], b.numpy()[a.box]) for a, b in zip(each, boxes, strict=True)]
    return Targets(
        torch.from_numpy(np.stack([a.weight for a in each])),
        torch.from_numpy(np.repeat(np.arange(len(each)), [len(a.place) for a in each])),
        torch.from_numpy(np.concatenate([a.place for a in each])),
        torch.from_numpy(np.concatenate(said).reshape(-1, RESIDUAL).astype(np.float32)),
    )


def assign(anchors: Floats, boxes: Array) -> Assigned:
    """Which anchors stand for which boxes, by bird's-eye overlap.

    An anchor takes the box that it overlaps most, if by `POSITIVE_IOU`. Each box takes the anchor that
    overlaps it most (the nearest one where none does) whatever its overlap; of two boxes that take the same
    anchor, the later one has it.

    Args:
        anchors: (k, 7).
        boxes: (m, 7).
    """
    most, owner = np.zeros(len(anchors)), np.full(len(anchors), -1)
    own = np.full(len(boxes), -1)
    columns = np.ascontiguousarray(anchors.T)
    reach = np.hypot(columns[3], columns[4]) / 2
    for number, box in enumerate(boxes):
        near, iou = _overlaps(columns, reach, box)
        own[number] = near[iou.argmax()] if iou.any() else _nearest(columns, box)
        better = iou > most[near]
        most[near[better]] = iou[better]
        owner[near[better]] = number
    weight = (most < NEGATIVE_IOU).astype(np.float32)
    owner[most < POSITIVE_IOU] = -1
    owner[own] = np.arange(len(boxes))
    place = np.flatnonzero(owner >= 0)
    weight[place] = 1
    return Assigned(weight, place, owner[place])


def _overlaps(columns: Floats, reach: Floats, box: Floats) -> tuple[Ints, Floats]:
    """Anchors near a box and their overlap with it; all that overlap by `NEGATIVE_IOU`, and the best one.

    Args:
        columns: (7, k) anchors.
        reach: (k,) half diagonals, seen from above.
        box: (7,).
    """
    bound = reach + np.hypot(box[3], box[4]) / 2
    near = np.flatnonzero((np.abs(columns[0] - box[0]) <= bound) & (np.abs(columns[1] - box[1]) <= bound))
    area, box_area = columns[3, near] * columns[4, near], box[3] * box[4]
    # Rectangles overlap by no more than the ratio of their areas.
    alike = near[np.minimum(area, box_area) >= NEGATIVE_IOU * np.maximum(area, box_area)]
    iou = _iou(columns, alike, box)
    if (iou >= NEGATIVE_IOU).any():
        return alike, iou
    return near, _iou(columns, near, box)


def _iou(columns: Floats, rows: Ints, box: Floats) -> Floats:
    return np.asarray(iou_bev_pairs(columns[:, rows].T, np.repeat(box[None], len(rows), axis=0)))


def _nearest(columns: Floats, box: Floats) -> int:
    return int((np.square(columns[0] - box[0]) + np.square(columns[1] - box[1])).argmin())
