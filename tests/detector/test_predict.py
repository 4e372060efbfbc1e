"""What a network finds in a frame: boxes on the ground, and the features of their points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import DECODING, shifted, small_config, street

from upvl_cli.detector.config import GroundingConfig
from upvl_cli.detector.data.batch import Sample, collate
from upvl_cli.detector.model import Detector
from upvl_cli.detector.predict import FrameInput, predict, put_on_ground
from upvl_cli.geometry.boxes import points_inside
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


def network(distills: bool = True) -> Detector:
    """A network that finds something on any street."""
    torch.manual_seed(1)
    detector = Detector(small_config(), distills).eval()
    with torch.no_grad():
        detector.box_head.weight.mul_(30)
    return detector


def frame(ground_z_m: float = -1.7) -> FrameInput:
    x, y = np.meshgrid(np.arange(-30, 30, 0.25), np.arange(-30, 30, 0.25))
    ground = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return FrameInput(street(1).points, ground, ground_z_m)


def test_features_are_those_of_the_points_of_this_sweep_inside_of_each_box() -> None:
    detector, given = network(), frame()
    found = predict(detector, given, replace(DECODING, min_score=0.0, nms_iou=0.9, max_boxes=12), RULE)
    assert len(found.boxes) == 12
    boxes = shifted(found.boxes, z=1.7)  # heights above the road, as the points have them
    batch = collate([Sample.from_points(given.points)], detector.grid)
    points = batch.points.numpy()
    with torch.no_grad():
        output = detector(batch)
        inside = points_inside(points[:, :3], boxes, margin_m=0.0) & (points[:, 5] == 0)
        assert found.num_points.tolist() == inside.sum(axis=1).tolist()
        assert len(set(found.num_points.tolist())) > 3
        assert found.point_feature.count.tolist() == found.num_points.tolist()
        for box in range(12):
            rows = torch.from_numpy(np.flatnonzero(inside[box]))
            expected = detector.features(output, batch, rows).numpy()
            mine = found.point_feature.values[found.point_feature.owner == box]
            np.testing.assert_allclose(mine, expected, atol=0.02, rtol=0.02)  # bfloat16 on some processors


def test_boxes_stand_on_the_ground_in_ego_axes_with_their_scores() -> None:
    detector, given = network(distills=False), frame()
    rule = replace(DECODING, min_score=0.0)
    found, at_zero = predict(detector, given, rule, RULE), predict(detector, frame(0.0), rule, RULE)
    np.testing.assert_allclose(found.boxes.center_m, at_zero.boxes.center_m + [0, 0, -1.7])
    np.testing.assert_allclose(at_zero.boxes.center_m[:, 2], at_zero.boxes.size_lwh_m[:, 2] / 2, atol=1e-6)
    assert (np.diff(found.boxes.score) <= 0).all()
    assert len(found.point_feature.values) == 0
    assert found.point_feature.count.tolist() == [0] * len(found.boxes)
    assert found.num_points.sum() > 0


def test_the_ground_below_is_a_median_of_enough_points_near_enough() -> None:
    box = Boxes.from_rows(np.array([[0.0, 0, 5, 4, 2, 1.0, 0]]))
    ground = np.array([[0.0, 0, 1], [1, 0, 1.2], [-1, 0, 9], [0, 1.25, 1.3], [0, 1.35, 9]])
    for few, expected in ((4, 1.25 + 0.5), (5, 5.0)):  # four points are below: the last is 0.35 m beside
        rule = GroundingConfig(margin_m=0.3, min_points=few)
        assert put_on_ground(box, ground, rule).center_m[0, 2] == pytest.approx(expected)


@pytest.mark.parametrize("distills", [True, False])
def test_boxes_without_points_are_counted_too(distills: bool) -> None:
    nothing = FrameInput(np.zeros((0, 6), np.float32), np.zeros((0, 3)), 0.0)
    found = predict(network(distills), nothing, replace(DECODING, min_score=0.0), RULE)
    assert found.num_points.tolist() == found.point_feature.count.tolist() == [0] * len(found.boxes)
    assert len(found.boxes) > 0
