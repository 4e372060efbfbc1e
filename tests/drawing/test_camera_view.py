"""Boxes on the camera's picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from upvl_cli.drawing import colours
from upvl_cli.drawing.birds_eye import BoxPaint
from upvl_cli.drawing.camera_view import camera_view
from upvl_cli.types import Camera, TrackedBoxes

# Looks along x from the ego origin: 100 px a unit of slope, centre at (600, 200).
AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
CAMERA = Camera("front", 1200, 400, np.array([[100.0, 0, 600], [0, 100, 200], [0, 0, 1]]), np.zeros(5), AHEAD)
GREY = np.full((400, 1200, 3), 90, np.uint8)


def tracked(*rows: list[float]) -> TrackedBoxes:
    """Boxes x, y, z, length, width, height, heading, of one track each."""
    n = len(rows)
    return TrackedBoxes.from_rows(
        np.array(rows), velocity_mps=np.zeros((n, 3)), score=np.ones(n), track_id=np.arange(n)
    )


def drawn(*rows: list[float]) -> np.ndarray:
    return np.asarray(camera_view(GREY, CAMERA, tracked(*rows)))


def test_the_near_face_stands_where_the_pinhole_puts_it() -> None:
    picture = drawn([12, 0, 0, 4, 4, 2, 0])  # the near face is 10 m ahead, 4 m wide, 2 m high: 40 by 20 px
    coloured = np.argwhere((picture == colours.track_colour(0)).all(axis=2))
    text_is_above = coloured[coloured[:, 0] >= 189]
    assert abs(text_is_above[:, 0].max() - 210) <= 1
    columns = coloured[np.abs(coloured[:, 0] - 200) <= 5][:, 1]
    assert abs(columns.min() - 580) <= 1
    assert abs(columns.max() - 620) <= 1


def test_a_box_behind_the_camera_leaves_no_trace() -> None:
    np.testing.assert_array_equal(drawn([-12, 0, 0, 4, 4, 2, 0]), GREY)


def test_without_boxes_it_is_the_picture() -> None:
    np.testing.assert_array_equal(drawn(), GREY)


def test_a_small_picture_is_enlarged() -> None:
    small = camera_view(GREY[:100, :300], CAMERA, tracked())
    assert small.size == (1200, 400)


def test_a_line_that_leads_far_aside_is_not_walked_along() -> None:
    # Its near edges span 9 000 million pixels: Pillow would take minutes, or count beyond its numbers.
    camera = replace(CAMERA, intrinsic=np.array([[1e6, 0, 600], [0, 1e6, 200], [0, 0, 1]]))
    boxes = tracked([5.0, 0, 0, 8, 9_000, 2, 0])
    np.testing.assert_array_equal(np.asarray(camera_view(GREY, camera, boxes)), GREY)


def test_colours_and_width_can_be_chosen() -> None:
    red, lime = (255, 0, 0), (0, 255, 0)
    boxes = tracked(
        [12, 2, 0, 4, 1, 2, 0], [8, -2, 0, 4, 1, 2, 0]
    )  # the nearer one is drawn last, and stays lime
    picture = camera_view(GREY, CAMERA, boxes, [BoxPaint(red, ""), BoxPaint(lime, "")], width_px=600)
    assert picture.size == (600, 200)
    pixels = np.asarray(picture)
    columns = {colour: np.argwhere((pixels == colour).all(axis=2))[:, 1] for colour in (red, lime)}
    assert columns[red].max() < 300 < columns[lime].min()  # left and right of the middle
