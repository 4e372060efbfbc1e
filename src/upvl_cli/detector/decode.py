"""From what the network says to boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from upvl_cli.detector.head import Head, decode
from upvl_cli.detector.model import Detector, Output
from upvl_cli.geometry.nms import nms_bev
from upvl_cli.types import Boxes, Floats

_RIVALS = 10  # times as many boxes as are asked for are looked at: places of one object say nearly the same


@dataclass(frozen=True)
class Detections:
    """Boxes of one frame by falling score.

    Attributes:
        seven: (m, 7) float64 boxes.
        score: (m,) float64, 0 to 1.
    """

    seven: Floats
    score: Floats


def detections(
    detector: Detector, output: Output, *, min_score: float, max_boxes: int, nms_iou: float
) -> list[Detections]:
    """Boxes of each sample of a batch.

    Args:
        detector: What said `output`.
        output: What it said.
        min_score: Boxes below are left out.
        max_boxes: No more than this, the best ones.
        nms_iou: Of two boxes that overlap more, seen from above, the one of lower score goes.
    """
    scores = torch.sigmoid(output.objectness.detach())
    return [
        _of_sample(detector.head, score, residual, min_score, max_boxes, nms_iou)
        for score, residual in zip(scores, output.residual.detach(), strict=True)
    ]


def _of_sample(
    head: Head, scores: Tensor, residual: Tensor, min_score: float, max_boxes: int, nms_iou: float
) -> Detections:
    best, place = scores.topk(min(_RIVALS * max_boxes, len(scores)))
    score, rows = best.cpu().numpy().astype(np.float64), place.cpu().numpy()
    good = score >= min_score
    seven = decode(head, head.places[rows[good]], residual[place].cpu().numpy()[good])
    score = score[good]
    kept = nms_bev(Boxes.from_rows(seven), score, max_iou=nms_iou, max_boxes=max_boxes)
    return Detections(seven[kept], score[kept])
