"""Boxes stand on the ground below them."""

from __future__ import annotations

import numpy as np
from scenes import shifted

from upvl_cli.detector.config import GroundingConfig
from upvl_cli.detector.predict import put_on_ground
from upvl_cli.types import Boxes, concat, empty

X, Y = np.meshgrid(np.arange(-10.0, 50.0, 0.5), np.arange(-10.0, 10.0, 0.5))
HILL = np.column_stack([X.ravel(), Y.ravel(), 0.05 * X.ravel()])
CAR = Boxes.from_rows(np.array([[30.0, 2.0, 0.8, 4.4, 1.8, 1.6, 0.4]]))
RULE = GroundingConfig(margin_m=0.3, min_points=3)


def test_feet_are_put_on_a_slope_and_nothing_else_changes() -> None:
    (found,) = put_on_ground(CAR, HILL, RULE).to_rows()
    assert abs(found[2] - (1.5 + 0.8)) < 0.02
    np.testing.assert_array_equal(np.delete(found, 2), np.delete(CAR.to_rows()[0], 2))


def test_some_of_several_boxes_stand_where_nothing_is_known() -> None:
    far = shifted(CAR, x=100)
    boxes = concat([far, CAR, far], Boxes)
    found = put_on_ground(boxes, HILL, RULE)
    np.testing.assert_array_equal(found.to_rows()[[0, 2]], boxes.to_rows()[[0, 2]])
    assert found.center_m[1, 2] > 2
    assert len(put_on_ground(empty(Boxes), HILL, RULE)) == 0
    np.testing.assert_array_equal(put_on_ground(boxes, np.zeros((0, 3)), RULE).to_rows(), boxes.to_rows())
    near = HILL[np.hypot(X, Y).ravel() < 8]
    np.testing.assert_array_equal(put_on_ground(CAR, near, RULE).to_rows(), CAR.to_rows())
