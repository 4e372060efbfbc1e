"""Which 2D box shows a label: the picture with the most of it, and the best box of each other."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.boxes import corners
from upvl_cli.perception.labels.box_matching import CameraView, match_boxes
from upvl_cli.types import Boxes, Boxes2d, Camera, empty

FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
# Of a cube of 2 m, 11 m ahead, the near face spans 20 px around (99.5, 49.5).
CUBE = [11.0, 0, 0, 2, 2, 2, 0]
FACE = [89.5, 39.5, 109.5, 59.5]


def camera(focal_px: float = 100.0) -> Camera:
    intrinsic = np.array([[focal_px, 0, 99.5], [0, focal_px, 49.5], [0, 0, 1]])
    return Camera("front", 200, 100, intrinsic, np.zeros(5), FORWARD)


def view(
    rows: list[list[float]], found: list[tuple[str, list[float], float]], focal_px: float = 100.0
) -> CameraView:
    boxes2d = empty(Boxes2d)
    if found:
        names, edges, scores = zip(*found, strict=True)
        boxes2d = Boxes2d(np.array(edges), np.array(scores), np.array(names))
    return CameraView(camera(focal_px), corners(Boxes.from_rows(np.array(rows))), boxes2d)


def test_iou_with_the_best_box_and_its_name() -> None:
    half = [89.5, 39.5, 99.5, 59.5]
    found = match_boxes([view([CUBE], [("car", half, 0.9), ("bus", FACE, 0.5)])], 1, min_iou=0.4)
    np.testing.assert_allclose(found.iou, [1.0])
    assert (found.name.tolist(), found.score.tolist(), found.view.tolist()) == (["bus"], [0.5], [0])


def test_a_box_that_is_too_far_off_gives_its_iou_and_no_name() -> None:
    quarter = [89.5, 39.5, 99.5, 49.5]
    found = match_boxes([view([CUBE], [("car", quarter, 0.9)])], 1, min_iou=0.4)
    np.testing.assert_allclose(found.iou, [0.25])
    assert found.name.tolist() == [""] and found.score.tolist() == [0.0]


def test_without_a_box_it_is_0_and_without_a_picture_less() -> None:
    behind = [-11.0, 0, 0, 2, 2, 2, 0]
    found = match_boxes([view([CUBE, behind], [])], 2, min_iou=0.4)
    assert (found.iou.tolist(), found.view.tolist()) == ([0.0, -1.0], [0, -1])
    nothing = match_boxes([], 2, min_iou=0.4)
    assert (nothing.iou.tolist(), nothing.view.tolist(), nothing.name.tolist()) == (
        [-1, -1],
        [-1, -1],
        ["", ""],
    )
    assert len(match_boxes([view([CUBE], [])], 0, min_iou=0.4).iou) == 0


def test_one_2d_box_shows_one_label() -> None:
    """Of two labels behind each other the one that fits better has the name; both have their IoU."""
    far = [23.0, 0, 0, 2, 2, 2, 0]  # its near face is at 22 m: 9.1 px wide
    found = match_boxes([view([far, CUBE], [("car", FACE, 0.9)])], 2, min_iou=0.1)
    assert found.name.tolist() == ["", "car"]
    np.testing.assert_allclose(found.iou, [(100 / 22 * 2 / 20) ** 2, 1.0])


def test_the_picture_that_shows_most_of_it_is_asked() -> None:
    """A lens of twice the focal length shows the label twice as large: 40 px."""
    large = [79.5, 29.5, 119.5, 69.5]
    views = [view([CUBE], [("car", FACE, 0.9)]), view([CUBE], [("bus", large, 0.8)], focal_px=200.0)]
    found = match_boxes(views, 1, min_iou=0.4)
    assert (found.view.tolist(), found.name.tolist()) == ([1], ["bus"])
    # At the border a larger picture of two thirds of it is worth less than one of all of it.
    beside = [11.0, 7.7, 0, 2, 2, 2, 0]
    views = [view([beside], []), view([beside], [], focal_px=130.0)]
    assert match_boxes(views, 1, min_iou=0.4).view.tolist() == [0]


def test_a_cyclist_is_compared_with_rider_and_bicycle_together() -> None:
    rider, bicycle = [92.5, 39.5, 106.5, 55.5], [89.5, 48.5, 109.5, 59.5]
    found = match_boxes([view([CUBE], [("person", rider, 0.9), ("bicycle", bicycle, 0.6)])], 1, min_iou=0.4)
    np.testing.assert_allclose(found.iou, [1.0])
    assert found.name.tolist() == ["cyclist"]
