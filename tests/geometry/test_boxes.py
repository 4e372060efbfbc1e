"""Corners, points inside and transforms of upright boxes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from on_rows import corners, corners_bev, pairs_inside, points_inside, transform

from upvl_cli.errors import BadInput
from upvl_cli.geometry.boxes import transform as transform_boxes
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.types import Boxes, TrackedBoxes


def random_boxes(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(0, 8, (n, 3)), rng.uniform(0.5, 6, (n, 3)), rng.uniform(-4, 4, n)])


def slow_inside(xyz: np.ndarray, boxes: np.ndarray, margin_m: float) -> np.ndarray:
    """Move the points into each box's own axes and compare."""
    rows = []
    for box in boxes:
        local = apply(inverse(from_yaw(box[6], box[:3])), xyz)
        rows.append((np.abs(local) <= box[3:6] / 2 + margin_m).all(axis=1))
    return np.array(rows).reshape(len(boxes), len(xyz))


def test_corners_of_a_box_that_looks_left() -> None:
    box = [[10, 20, 1, 4, 2, 3, math.pi / 2]]
    floor = [[9, 22], [9, 18], [11, 18], [11, 22]]
    np.testing.assert_allclose(corners_bev(box)[0], floor, atol=1e-12)
    eight = corners(box)[0]
    np.testing.assert_allclose(eight[:, :2], floor * 2, atol=1e-12)
    np.testing.assert_allclose(eight[:, 2], [-0.5] * 4 + [2.5] * 4)


@pytest.mark.parametrize("margin_m", [0.0, 0.4, -0.2])
def test_points_inside_equal_the_slow_way(margin_m: float) -> None:
    boxes, xyz = random_boxes(30), np.random.default_rng(1).normal(0, 8, (5000, 3)).astype(np.float32)
    inside = points_inside(xyz, boxes, margin_m=margin_m)
    np.testing.assert_array_equal(
        points_inside(xyz, boxes[:3], margin_m=margin_m), inside[:3]
    )  # without a sort
    np.testing.assert_array_equal(inside, slow_inside(xyz, boxes, margin_m))
    assert inside.any(axis=1).mean() > 0.5


def test_pairs_come_in_ascending_order() -> None:
    boxes, xyz = random_boxes(30), np.random.default_rng(1).normal(0, 8, (5000, 3))
    box, point = pairs_inside(xyz, boxes, margin_m=0.0)
    np.testing.assert_array_equal(np.stack([box, point]), np.nonzero(slow_inside(xyz, boxes, 0.0)))


PLACES = [
    ("the centre", [5, 5, 5], True),
    ("on a face", [7, 5, 5], True),
    ("on a corner", [7, 6, 5.5], True),
    ("just outside", [7.000001, 5, 5], False),
    ("above", [5, 5, 5.6], False),
    ("not a number", [math.nan, 5, 5], False),
    ("not a number, height only", [5, 5, math.nan], False),
    ("infinite", [math.inf, 5, 5], False),
]


@pytest.mark.parametrize(("xyz", "expected"), [c[1:] for c in PLACES], ids=[c[0] for c in PLACES])
def test_one_place(xyz: list[float], expected: bool) -> None:
    assert points_inside([xyz], [[5, 5, 5, 4, 2, 1, 0]], margin_m=0.0).item() is expected


def test_corners_move_with_the_box() -> None:
    boxes, turn = random_boxes(20), from_yaw(2.5, [100.0, -50.0, 3.0])
    moved = transform(boxes, turn)
    for before, after in zip(corners(boxes), corners(moved), strict=True):
        np.testing.assert_allclose(apply(turn, before), after, atol=1e-9)
    assert ((moved[:, 6] >= -math.pi) & (moved[:, 6] < math.pi)).all()
    back = transform(moved, inverse(turn))
    np.testing.assert_allclose(back[:, :6], boxes[:, :6], atol=1e-9)
    np.testing.assert_allclose(np.cos(back[:, 6] - boxes[:, 6]), 1)


def test_the_input_stays_as_it_is() -> None:
    boxes = random_boxes(3)
    before = boxes.copy()
    transform(boxes, from_yaw(1.0, [1, 2, 3]))
    np.testing.assert_array_equal(boxes, before)


def test_empty() -> None:
    assert corners_bev([]).shape == (0, 4, 2)
    assert corners(np.zeros((0, 7))).shape == (0, 8, 3)
    assert transform([], np.eye(4)).shape == (0, 7)
    box = np.array([[0, 0, 0, 1, 1, 1, 0]])
    assert points_inside(np.zeros((0, 3)), box, margin_m=0.0).shape == (1, 0)
    assert points_inside(np.zeros((4, 3)), [], margin_m=0.0).shape == (0, 4)
    assert [part.size for part in pairs_inside(np.zeros((0, 3)), [], margin_m=0.0)] == [0, 0]


def test_bad_boxes_are_refused_in_one_line() -> None:
    with pytest.raises(BadInput, match=r"^boxes have shape \(1, 6\), expected \(n, 7\).*$"):
        corners(np.zeros((1, 6)))


@pytest.mark.parametrize("column", range(7))
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_box_with_one_number_that_is_not_finite_is_named(column: int, bad: float) -> None:
    rows = np.ones((4, 7))
    rows[2, column] = bad
    for refuses in (corners, corners_bev, lambda boxes: transform(boxes, np.eye(4))):
        with pytest.raises(BadInput, match=r"^box 2 is not finite: .*$"):
            refuses(Boxes.from_rows(rows))


def test_a_transform_leaves_behind_what_only_a_subclass_knows() -> None:
    """A velocity along the axes of src would be wrong along those of dst."""
    tracked = TrackedBoxes.from_rows(
        random_boxes(3), velocity_mps=np.ones((3, 3)), score=np.ones(3), track_id=np.arange(3)
    )
    turn = from_yaw(0.5, [1.0, 2.0, 3.0])
    moved = transform_boxes(tracked, turn)
    assert type(moved) is Boxes
    np.testing.assert_array_equal(moved.to_rows(), transform(random_boxes(3), turn))
