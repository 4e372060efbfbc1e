"""Boxes stand on the ground below them."""

from __future__ import annotations

import numpy as np

from upvl_cli.detector.finding import standing

X, Y = np.meshgrid(np.arange(-10.0, 50.0, 0.5), np.arange(-10.0, 10.0, 0.5))
HILL = np.column_stack([X.ravel(), Y.ravel(), 0.05 * X.ravel()])
CAR = np.array([30.0, 2.0, 0.8, 4.4, 1.8, 1.6, 0.4])


def test_feet_are_put_on_a_slope_and_nothing_else_changes() -> None:
    (found,) = standing(CAR[None], HILL)
    assert abs(found[2] - (1.5 + 0.8)) < 0.02
    np.testing.assert_array_equal(np.delete(found, 2), np.delete(CAR, 2))


def test_some_of_several_boxes_stand_where_nothing_is_known() -> None:
    far = CAR + np.array([100.0, 0, 0, 0, 0, 0, 0])
    boxes = np.array([far, CAR, far])
    found = standing(boxes, HILL)
    np.testing.assert_array_equal(found[[0, 2]], boxes[[0, 2]])
    assert found[1, 2] > 2
    assert standing(np.zeros((0, 7)), HILL).shape == (0, 7)
    np.testing.assert_array_equal(standing(boxes, np.zeros((0, 3))), boxes)
    np.testing.assert_array_equal(standing(CAR[None], HILL[np.hypot(X, Y).ravel() < 8]), CAR[None])
