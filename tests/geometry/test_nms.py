"""Of two boxes on one object the better one stays."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.geometry.iou import iou_bev
from upvl_cli.geometry.nms import nms_bev
from upvl_cli.types import Boxes


def plain(boxes: Boxes, score: np.ndarray, max_iou: float) -> list[int]:
    """The rule once more, box by box."""
    kept: list[int] = []
    iou = iou_bev(boxes, boxes)
    for box in sorted(range(len(boxes)), key=lambda row: (-score[row], row)):
        if all(iou[other, box] <= max_iou for other in kept):
            kept.append(box)
    return kept


def cars(*x_m: float) -> Boxes:
    """Cars of 4 by 2 m in one lane."""
    return Boxes.from_rows(np.array([[x, 0.0, 0, 4, 2, 1.5, 0] for x in x_m]))


def test_the_better_of_two_stays() -> None:
    assert nms_bev(cars(0, 0.5, 10), np.array([0.3, 0.8, 0.1]), max_iou=0.2).tolist() == [1, 2]


def test_what_goes_takes_no_other_with_it() -> None:
    row = cars(0, 2, 4)  # the middle one overlaps both, which touch
    assert nms_bev(row, np.array([0.9, 0.8, 0.7]), max_iou=0.2).tolist() == [0, 2]


def test_boxes_come_by_falling_score_and_the_first_of_equal_ones_stays() -> None:
    score = np.array([0.5, 0.9, 0.5, 0.5])
    assert nms_bev(cars(0, 20, 0.1, 40), score, max_iou=0.2).tolist() == [1, 0, 3]


def test_an_overlap_at_the_limit_is_none_too_many() -> None:
    pair = cars(0, 2)
    third = float(iou_bev(pair[:1], pair[1:])[0, 0])  # 4 m^2 of 12
    assert third == pytest.approx(1 / 3)
    assert nms_bev(pair, np.ones(2), max_iou=third).tolist() == [0, 1]
    assert nms_bev(pair, np.ones(2), max_iou=np.nextafter(third, 0)).tolist() == [0]


def test_height_does_not_tell_boxes_apart() -> None:
    rows = cars(0, 0).to_rows()
    rows[1, 2] = 30.0
    assert nms_bev(Boxes.from_rows(rows), np.ones(2), max_iou=0.2).tolist() == [0]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("total", [20, 150])  # fewer and more than are compared at once
def test_as_the_plain_rule(seed: int, total: int) -> None:
    rng = np.random.default_rng(seed)
    reach_m = total / 4
    rows = np.column_stack(
        [
            rng.uniform(0, reach_m, (total, 2)),
            np.zeros(total),
            np.full((total, 3), (4, 2, 1.5)),
            rng.uniform(-3, 3, total),
        ]
    )
    boxes, score = Boxes.from_rows(rows), rng.integers(0, 10, total) / 10
    expected = plain(boxes, score, 0.3)
    assert 0 < len(expected) < total
    assert nms_bev(boxes, score, max_iou=0.3).tolist() == expected
    for limit in (0, 1, 7, 40, 1000):
        assert nms_bev(boxes, score, max_iou=0.3, max_boxes=limit).tolist() == expected[:limit]


def test_no_box_at_all() -> None:
    none = Boxes.from_rows(np.zeros((0, 7)))
    kept = nms_bev(none, np.zeros(0), max_iou=0.2)
    assert kept.shape == (0,)
    assert len(none[kept]) == 0
