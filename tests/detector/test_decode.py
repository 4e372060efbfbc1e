"""Boxes from what a network could say."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scenes import BOXES, SMALL

from upvl_cli.detector.decode import Detections, detections
from upvl_cli.detector.head import encode
from upvl_cli.detector.model import HEADS, Detector, Output
from upvl_cli.geometry.iou import iou_bev

RULE = {"min_score": 0.3, "max_boxes": 10, "nms_iou": 0.3}


def saying(detector: Detector, boxes: np.ndarray, score: list[float], places: list[int]) -> Output:
    """An output that says the boxes at these places, and nothing elsewhere."""
    objectness = torch.full((1, len(detector.head.places)), -20.0)
    residual = torch.zeros(1, len(detector.head.places), 8)
    objectness[0, places] = torch.logit(torch.tensor(score))
    rows = torch.from_numpy(encode(detector.head, detector.head.places[places], boxes)).float()
    residual[0, places] = rows
    return Output(objectness, residual, torch.zeros(1, 0, 0))


def found(boxes: np.ndarray, score: list[float], encoder: str = "centres", **rule: float) -> Detections:
    detector = Detector(SMALL, 8, encoder, False)
    output = saying(detector, boxes, score, list(range(50, 50 + len(boxes))))
    return detections(detector, output, **(RULE | rule))[0]


@pytest.mark.parametrize("encoder", list(HEADS))
def test_boxes_come_by_falling_score(encoder: str) -> None:
    seen = found(BOXES, [0.5, 0.9, 0.4, 0.7, 0.6], encoder)
    np.testing.assert_allclose(seen.score, [0.9, 0.7, 0.6, 0.5, 0.4], atol=1e-6)
    np.testing.assert_allclose(seen.seven[:, :6], BOXES[[1, 3, 4, 0, 2], :6], atol=1e-4)
    # The direction of an anchor is a yes or no: 1 says "looks back" as the network would.
    np.testing.assert_allclose(np.cos(seen.seven[:, 6] - BOXES[[1, 3, 4, 0, 2], 6]), 1, atol=1e-6)
    assert seen.seven.dtype == seen.score.dtype == np.float64


def test_of_two_that_overlap_the_better_stays() -> None:
    beside = BOXES[0] + [0.5, 0, 0, 0, 0, 0, 0]
    seen = found(np.stack([BOXES[0], beside, BOXES[1]]), [0.6, 0.8, 0.5])
    np.testing.assert_allclose(seen.seven[:, 0], [beside[0], BOXES[1, 0]], atol=1e-4)
    assert len(found(np.stack([BOXES[0], beside]), [0.6, 0.8], nms_iou=0.95).score) == 2


def test_a_box_that_went_takes_none_with_it() -> None:
    row = np.stack([BOXES[0] + [1.5 * step, 0, 0, 0, 0, 0, 0] for step in range(3)])
    row[:, 6] = (
        0  # a chain: the first overlaps the second by 0.49, the second the third, the first not the third
    )
    seen = found(row, [0.9, 0.8, 0.7])
    np.testing.assert_allclose(seen.seven[:, 0], row[[0, 2], 0], atol=1e-4)


def test_of_many_boxes_those_stay_that_a_plain_loop_keeps() -> None:
    rng = np.random.default_rng(5)
    centre, size = rng.uniform(-10, 10, (90, 3)), rng.uniform(1, 4, (90, 3))
    boxes = np.column_stack([centre, size, rng.uniform(-3, 3, 90)])
    kept: list[int] = []
    for box in range(90):  # the first is the best
        if not (iou_bev(boxes[box : box + 1], boxes[kept]) > 0.1).any():
            kept.append(box)
    seen = found(boxes, np.linspace(0.9, 0.4, 90).tolist(), max_boxes=90, nms_iou=0.1)
    assert 33 < len(kept) < 80
    np.testing.assert_allclose(seen.seven[:, :6], boxes[kept, :6], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("rule", "count"),
    [({"min_score": 0.55}, 3), ({"max_boxes": 2}, 2), ({"min_score": 0.95}, 0)],
)
def test_limits(rule: dict[str, float], count: int) -> None:
    seen = found(BOXES, [0.5, 0.9, 0.4, 0.7, 0.6], **rule)
    assert seen.seven.shape == (count, 7)
    assert seen.score.tolist() == pytest.approx([0.9, 0.7, 0.6][:count])


def test_a_wild_size_stays_finite() -> None:
    detector = Detector(SMALL, 8, "anchors", False)
    output = saying(detector, BOXES[:1], [0.9], [7])
    output.residual[0, 7, 3:6] = 1e6
    assert np.isfinite(detections(detector, output, **RULE)[0].seven).all()
