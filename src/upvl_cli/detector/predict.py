"""What a trained network finds in a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from upvl_cli.detector.batch import FEATURE, Sample, collate
from upvl_cli.detector.decode import detections
from upvl_cli.detector.model import Detector
from upvl_cli.detector.together import half_precision
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.types import Array, Floats, Ints

_AROUND_M = 0.3  # ground so far beside a box is below it too
_FEW = 3  # fewer places on the ground say nothing
_ANY_HEIGHT_M = 1e3


@dataclass(frozen=True)
class Found:
    """Boxes of a frame, by falling score.

    Attributes:
        seven: (m, 7) in ego axes.
        score: (m,) 0 to 1.
        points: (m,) points of this sweep inside of each.
        of_box: (n,) place of the box that each of these points is in; empty without distillation, as is
        feature: (n, 64) kept values of their features.
    """

    seven: Floats
    score: Floats
    points: Ints
    of_box: Ints
    feature: Floats


@torch.no_grad()
def find(
    detector: Detector,
    points: Array,
    floor_m: Array,
    ground_z_m: float,
    *,
    min_score: float,
    max_boxes: int,
    nms_iou: float,
) -> Found:
    """Find boxes in two sweeps.

    Args:
        detector: A trained network.
        points: (n, 6) from `Route.points`.
        floor_m: (k, 3) the ground below some points, in the axes of the points: boxes stand on it.
        ground_z_m: Height of the road in ego axes, which the points are without.
        min_score: Boxes below are left out.
        max_boxes: No more than this, the best ones.
        nms_iou: Of two boxes that overlap more, seen from above, the worse goes.
    """
    device = next(detector.parameters()).device
    batch = collate([Sample.of_points(points)], detector.grid).to(device)
    with half_precision(device, wanted=True):
        output = detector(batch)
    (boxes,) = detections(detector, output, min_score=min_score, max_boxes=max_boxes, nms_iou=nms_iou)
    stand = standing(boxes.seven, floor_m)
    kept = batch.points.cpu().numpy()
    now = np.flatnonzero(kept[:, 5] == 0)
    of_box, inside = pairs_inside(kept[now, :3], stand, margin_m=0.0)
    count = np.bincount(of_box, minlength=len(boxes.seven))
    feature = np.zeros((0, FEATURE), dtype=np.float32)
    if detector.tells is None:
        of_box = of_box[:0]
    else:
        rows = torch.from_numpy(now[inside]).to(device)
        feature = detector.features(output, batch, rows).float().cpu().numpy()
    seven = stand + ground_z_m * np.eye(7)[2]
    return Found(seven, boxes.score, count, of_box, feature)


def standing(seven: Floats, floor_m: Array) -> Floats:
    """The boxes with their feet on the ground, where it is known below them.

    A slope takes the road far from the height it has at the car, by more than a network tells from a few points.

    Args:
        seven: (m, 7).
        floor_m: (k, 3) places on the ground.
    """
    column = seven.copy()
    column[:, 2], column[:, 5] = 0.0, _ANY_HEIGHT_M
    of_box, place = pairs_inside(floor_m, column, margin_m=_AROUND_M)
    stand = seven.copy()
    for box, below in enumerate(np.split(place, np.searchsorted(of_box, np.arange(1, len(seven))))):
        if len(below) >= _FEW:
            stand[box, 2] = np.median(floor_m[below, 2]) + seven[box, 5] / 2
    return stand
