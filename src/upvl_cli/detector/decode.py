"""Boxes from the output of the network: highest scores, decoded, without those that overlap better ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from upvl_cli.detector.config import DecodeConfig
from upvl_cli.detector.heads.base import Head, decode
from upvl_cli.detector.model import Detector, Output
from upvl_cli.geometry.nms import nms_bev
from upvl_cli.types import Array, Boxes, array


@dataclass(frozen=True)
class Detections(Boxes):
    """Boxes of one frame by falling score.

    Attributes:
        score: (m,) float64, 0 to 1.
    """

    score: Array = array("float64")


def decode_output(detector: Detector, output: Output, config: DecodeConfig) -> list[Detections]:
    """Return the boxes of each sample of a batch.

    Args:
        detector: The network that gave `output`.
        output: Its output.
        config: Which boxes are kept.
    """
    scores = torch.sigmoid(output.objectness.detach())
    return [
        _decode_sample(detector.head, score, residual, config)
        for score, residual in zip(scores, output.residual.detach(), strict=True)
    ]


def _decode_sample(head: Head, scores: Tensor, residual: Tensor, config: DecodeConfig) -> Detections:
    best, anchor = scores.topk(min(config.candidates_per_box * config.max_boxes, len(scores)))
    score, rows = best.cpu().numpy().astype(np.float64), anchor.cpu().numpy()
    good = score >= config.min_score
    boxes = decode(head, head.anchors[rows[good]], residual[anchor].cpu().numpy()[good])
    score = score[good]
    kept = nms_bev(boxes, score, max_iou=config.nms_iou, max_boxes=config.max_boxes)
    stays = boxes[kept]
    return Detections(stays.center_m, stays.size_lwh_m, stays.heading_rad, score[kept])
