"""Boxes from what a network could say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import BOXES, CODERS, DECODING, shifted, small_config

from upvl_cli.detector.decode import Detections, decode_output
from upvl_cli.detector.heads.base import encode
from upvl_cli.detector.model import Detector, Output
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.types import Boxes, concat


def output_of(detector: Detector, boxes: Boxes, score: list[float], anchors: list[int]) -> Output:
    """An output that encodes the boxes at these anchors, and nothing elsewhere."""
    objectness = torch.full((1, len(detector.head.anchors)), -20.0)
    residual = torch.zeros(1, len(detector.head.anchors), 8)
    objectness[0, anchors] = torch.logit(torch.tensor(score))
    rows = torch.from_numpy(encode(detector.head, detector.head.anchors[anchors], boxes)).float()
    residual[0, anchors] = rows
    return Output(objectness, residual, torch.zeros(1, 0, 0))


def decoded(boxes: Boxes, score: list[float], box_coder: str = "centers", **rule: float) -> Detections:
    detector = Detector(small_config(box_coder), False)
    output = output_of(detector, boxes, score, list(range(50, 50 + len(boxes))))
    return decode_output(detector, output, replace(DECODING, **rule))[0]


@pytest.mark.parametrize("box_coder", CODERS)
def test_boxes_come_by_falling_score(box_coder: str) -> None:
    seen = decoded(BOXES, [0.5, 0.9, 0.4, 0.7, 0.6], box_coder)
    np.testing.assert_allclose(seen.score, [0.9, 0.7, 0.6, 0.5, 0.4], atol=1e-6)
    np.testing.assert_allclose(seen.to_rows()[:, :6], BOXES.to_rows()[[1, 3, 4, 0, 2], :6], atol=1e-4)
    # The direction of an anchor is a yes or no: 1 says "looks back" as the network would.
    np.testing.assert_allclose(np.cos(seen.heading_rad - BOXES.heading_rad[[1, 3, 4, 0, 2]]), 1, atol=1e-6)
    assert seen.center_m.dtype == seen.score.dtype == np.float64


def test_of_two_that_overlap_the_better_stays() -> None:
    beside = shifted(BOXES[:1], x=0.5)
    seen = decoded(concat([BOXES[:1], beside, BOXES[1:2]], Boxes), [0.6, 0.8, 0.5])
    np.testing.assert_allclose(seen.center_m[:, 0], [beside.center_m[0, 0], BOXES.center_m[1, 0]], atol=1e-4)
    assert len(decoded(concat([BOXES[:1], beside], Boxes), [0.6, 0.8], nms_iou=0.95)) == 2


def test_a_box_that_went_takes_none_with_it() -> None:
    # A chain: the first overlaps the second by 0.49, the second the third, the first not the third.
    row = concat([shifted(BOXES[:1], x=1.5 * step) for step in range(3)], Boxes)
    row = replace(row, heading_rad=np.zeros(3))
    seen = decoded(row, [0.9, 0.8, 0.7])
    np.testing.assert_allclose(seen.center_m[:, 0], row.center_m[[0, 2], 0], atol=1e-4)


def test_of_many_boxes_those_stay_that_a_plain_loop_keeps() -> None:
    rng = np.random.default_rng(5)
    centre, size = rng.uniform(-10, 10, (90, 3)), rng.uniform(1, 4, (90, 3))
    boxes = Boxes(centre, size, rng.uniform(-3, 3, 90))
    kept: list[int] = []
    for box in range(90):  # the first is the best
        if not (iou_bev(boxes[box : box + 1], boxes[kept]) > 0.1).any():
            kept.append(box)
    seen = decoded(boxes, np.linspace(0.9, 0.4, 90).tolist(), max_boxes=90, nms_iou=0.1)
    assert 33 < len(kept) < 80
    np.testing.assert_allclose(seen.to_rows()[:, :6], boxes[kept].to_rows()[:, :6], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("rule", "count"),
    [({"min_score": 0.55}, 3), ({"max_boxes": 2}, 2), ({"min_score": 0.95}, 0)],
)
def test_limits(rule: dict[str, float], count: int) -> None:
    seen = decoded(BOXES, [0.5, 0.9, 0.4, 0.7, 0.6], **rule)
    assert len(seen) == count
    assert seen.score.tolist() == pytest.approx([0.9, 0.7, 0.6][:count])


def test_a_wild_size_stays_finite() -> None:
    detector = Detector(small_config("anchors"), False)
    output = output_of(detector, BOXES[:1], [0.9], [7])
    output.residual[0, 7, 3:6] = 1e6
    assert np.isfinite(decode_output(detector, output, DECODING)[0].to_rows()).all()


def test_the_bounds_of_score_and_overlap_belong_to_what_stays() -> None:
    assert len(decoded(BOXES[:2], [0.5, 0.4], min_score=0.5)) == 1  # the logit of 0.5 is 0: no rounding
    both = decoded(concat([BOXES[:1], shifted(BOXES[:1], x=0.5)], Boxes), [0.9, 0.8], nms_iou=1.0)
    assert len(both) == 2
    overlap = float(iou_bev(both[:1], both[1:])[0, 0])
    pair = concat([BOXES[:1], shifted(BOXES[:1], x=0.5)], Boxes)
    assert len(decoded(pair, [0.9, 0.8], nms_iou=overlap)) == 2
    assert len(decoded(pair, [0.9, 0.8], nms_iou=overlap - 1e-6)) == 1


def test_no_more_candidates_are_decoded_than_the_settings_say() -> None:
    crowd = concat([shifted(BOXES[:1], x=0.1 * step) for step in range(4)] + [BOXES[1:2]], Boxes)
    score = [0.9, 0.8, 0.7, 0.6, 0.5]
    assert len(decoded(crowd, score, max_boxes=2, candidates_per_box=2)) == 1  # four, all of one object
    assert len(decoded(crowd, score, max_boxes=2, candidates_per_box=3)) == 2


def test_each_sample_has_its_own_boxes() -> None:
    detector = Detector(small_config("centers"), False)
    parts = [output_of(detector, BOXES[n : n + 1], [0.9 - 0.1 * n], [60 + n]) for n in range(2)]
    output = Output(
        *(torch.cat([getattr(p, name) for p in parts]) for name in ("objectness", "residual")), None
    )
    first, second = decode_output(detector, output, DECODING)
    np.testing.assert_allclose(first.center_m, BOXES.center_m[:1], atol=1e-5)
    np.testing.assert_allclose(second.center_m, BOXES.center_m[1:2], atol=1e-5)
    np.testing.assert_allclose([first.score[0], second.score[0]], [0.9, 0.8], atol=1e-6)


def test_a_suppressed_box_stays_suppressed_when_another_is_kept_in_between() -> None:
    boxes = concat([BOXES[:1], BOXES[1:2], shifted(BOXES[:1], x=0.5)], Boxes)
    np.testing.assert_allclose(decoded(boxes, [0.9, 0.8, 0.7]).score, [0.9, 0.8], atol=1e-6)
