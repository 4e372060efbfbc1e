"""Which 2D box shows which 3D box: by the rectangle around the 3D box's projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.box_projection import iou_of_rectangles, projected_boxes
from upvl_cli.perception.visual.riders import merge_riders
from upvl_cli.types import Array, Boxes2d, Camera, Floats, Ints

NO_CAMERA, NO_IOU = -1, -1.0


@dataclass(frozen=True)
class CameraView:
    """The 3D boxes of a frame and the 2D boxes of one of its pictures.

    Attributes:
        camera: The camera.
        corners_m: (b, 8, 3) corners of the 3D boxes in ego axes at the time of the picture.
        boxes: The 2D boxes.
    """

    camera: Camera
    corners_m: Array
    boxes: Boxes2d


@dataclass(frozen=True)
class Matches:
    """What the pictures of a frame say of its 3D boxes.

    Attributes:
        view: (b,) number of the view with the largest part of the 3D box, `NO_CAMERA` where none has any.
        iou: (b,) IoU of the rectangle around its projection with the best 2D box there; 0 where none overlaps it,
            `NO_IOU` without a view.
        name: (b,) name of the 2D box that shows it: the best one of each other; empty for none.
        score: (b,) confidence of that 2D box, 0 for none.
    """

    view: Ints
    iou: Floats
    name: Array
    score: Floats


def match_boxes(views: Sequence[CameraView], total: int, *, min_iou: float) -> Matches:
    """Return which 2D box shows each 3D box.

    A 3D box is looked for in one picture: where its projection, clipped to the picture, is largest, times the share of
    it that is inside.

    Args:
        views: The pictures of a frame.
        total: Number b of 3D boxes.
        min_iou: IoU from which on a 2D box shows a 3D box.
    """
    view: Ints = np.full(total, NO_CAMERA, dtype=np.int64)
    iou, score = np.full(total, NO_IOU), np.zeros(total)
    name = [""] * total
    projected = [projected_boxes(each.camera, each.corners_m) for each in views]
    weight = [
        np.where(share > 0, share * (edges[:, 2:] - edges[:, :2]).prod(axis=1), 0.0)
        for edges, share in projected
    ]
    if views and total:
        best = np.argmax(weight, axis=0)
        view = np.where(np.max(weight, axis=0) > 0, best, NO_CAMERA)
    for number, (each, (edges, _)) in enumerate(zip(views, projected, strict=True)):
        rows = np.flatnonzero(view == number)
        boxes = merge_riders(each.boxes)
        ious = iou_of_rectangles(edges[rows], boxes.xyxy_px)
        iou[rows] = ious.max(axis=1, initial=0.0)
        if not ious.size:
            continue
        shown_by, shows = ious.argmax(axis=1), ious.argmax(axis=0)
        is_shown = (shows[shown_by] == np.arange(len(rows))) & (iou[rows] >= min_iou)
        for row in np.flatnonzero(is_shown).tolist():
            name[rows[row]] = str(boxes.name[shown_by[row]])
            score[rows[row]] = boxes.score[shown_by[row]]
    return Matches(view, iou, np.array(name, dtype=np.str_), score)
