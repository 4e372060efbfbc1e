"""Riders in 2D: detectors of COCO's kinds see a person and a bicycle where labels have one cyclist."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Bools, Boxes2d, Floats

PERSON = "person"
RIDER_OF = {"bicycle": "cyclist", "motorcycle": "motorcyclist"}
_MIN_OVERLAP = 0.5  # of the narrower one's width: a rider sits above the wheels
_MIN_SEAT = 0.25  # of the person's height that is above the bicycle's top: who stands behind one shows less
_MAX_GAP = 0.1  # of the person's height between the person's lower edge and the bicycle's top


def merge_riders(boxes: Boxes2d) -> Boxes2d:
    """Return the boxes of one picture with each person on a bicycle or motorcycle as one box around both.

    A person rides what overlaps below: by half the width of the narrower of both, with the person's head well above
    it, and the lowest part of the person not below its wheels. Each is used once, those of higher scores first.

    Args:
        boxes: n boxes of one picture.
    """
    person = np.flatnonzero(boxes.name == PERSON)
    vehicle = np.flatnonzero(np.isin(boxes.name, list(RIDER_OF)))
    pairs = np.argwhere(_rides(boxes.xyxy_px[person], boxes.xyxy_px[vehicle]))
    riders, below = person[pairs[:, 0]], vehicle[pairs[:, 1]]
    order = np.argsort(-(boxes.score[riders] + boxes.score[below]), kind="stable")
    edges_px, name = boxes.xyxy_px.copy(), boxes.name.tolist()
    used: set[int] = set()
    ridden: list[int] = []
    for rider, vehicle_row in zip(riders[order].tolist(), below[order].tolist(), strict=True):
        if used.isdisjoint((rider, vehicle_row)):
            used |= {rider, vehicle_row}
            ridden.append(vehicle_row)
            edges_px[rider, :2] = np.minimum(edges_px[rider, :2], edges_px[vehicle_row, :2])
            edges_px[rider, 2:] = np.maximum(edges_px[rider, 2:], edges_px[vehicle_row, 2:])
            name[rider] = RIDER_OF[name[vehicle_row]]
    kept = np.setdiff1d(np.arange(len(boxes)), ridden)
    return Boxes2d(edges_px, boxes.score, np.array(name, dtype=np.str_))[kept]


def _rides(person_px: Floats, vehicle_px: Floats) -> Bools:
    """Return (p, v) whether each person is above each vehicle as a rider is."""
    person, vehicle = person_px[:, None], vehicle_px[None]
    shared = np.minimum(person[..., 2], vehicle[..., 2]) - np.maximum(person[..., 0], vehicle[..., 0])
    narrower = np.minimum(person[..., 2] - person[..., 0], vehicle[..., 2] - vehicle[..., 0])
    height = person[..., 3] - person[..., 1]
    above = vehicle[..., 1] - person[..., 1]
    gap = vehicle[..., 1] - person[..., 3]
    below = person[..., 3] - vehicle[..., 3]
    is_above = (above >= _MIN_SEAT * height) & (gap <= _MAX_GAP * height) & (below <= _MAX_GAP * height)
    return np.asarray((shared >= _MIN_OVERLAP * narrower) & is_above)
