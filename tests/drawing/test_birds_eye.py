"""Pictures from above: what is where, in which colour."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.drawing import colours
from upvl_cli.drawing.birds_eye import PIXELS_PER_METRE, BoxPaint, View, birds_eye
from upvl_cli.types import TrackedBoxes, empty

VIEW = View(x_min_m=-5.0, x_max_m=15.0, y_min_m=-8.0, y_max_m=8.0)
NO_BOXES = empty(TrackedBoxes)


def picture(xyz: list[list[float]], state: list[int], boxes: TrackedBoxes = NO_BOXES) -> np.ndarray:
    return np.asarray(birds_eye(VIEW, np.array(xyz).reshape(-1, 3), np.array(state), boxes, {}, ""))


def pixel(x_m: float, y_m: float) -> tuple[int, int]:
    """Row and column of a place: forward is up, left is left."""
    return int((15 - x_m) * PIXELS_PER_METRE), int((8 - y_m) * PIXELS_PER_METRE)


def test_the_picture_has_the_size_of_the_view() -> None:
    assert picture([], []).shape == (20 * PIXELS_PER_METRE, 16 * PIXELS_PER_METRE, 3)


def test_a_point_shows_its_state_where_it_is() -> None:
    drawn = picture([[7, 3, 0], [8, -3, 1], [9, 4.5, 1]], [0, 1, 2])
    assert tuple(drawn[pixel(7, 3)]) == colours.GROUND
    assert tuple(drawn[pixel(8, -3)]) == colours.STATIC
    assert tuple(drawn[pixel(9, 4.5)]) == colours.MOVING


def test_points_out_of_view_are_left_out() -> None:
    np.testing.assert_array_equal(picture([[99, 0, 0], [0, -99, 0]], [1, 2]), picture([], []))


def test_a_box_is_drawn_in_the_colour_of_its_track() -> None:
    box = TrackedBoxes.from_rows(
        np.array([[7, 0, 1, 4, 2, 1.5, 0]]), velocity_mps=np.zeros((1, 3)), score=np.ones(1), track_id=[3]
    )
    drawn = picture([], [], box)
    for x_m, y_m in ((9, 0.5), (5, 0.5), (7, 1), (7, -1), (8, 0)):  # four sides, and the line to the nose
        row, column = pixel(x_m, y_m)
        near = drawn[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3)
        assert colours.track_colour(3) in [tuple(colour) for colour in near], (x_m, y_m)


def test_neighbouring_tracks_have_colours_that_differ() -> None:
    shades = np.array([colours.track_colour(number) for number in range(6)], dtype=float)
    apart = np.linalg.norm(shades[:, None] - shades, axis=2)[~np.eye(6, dtype=bool)]
    assert apart.min() > 50


def test_a_box_and_its_tail_can_have_another_colour_and_the_view_another_scale() -> None:
    box = TrackedBoxes.from_rows(
        np.array([[7, 0, 1, 4, 2, 1.5, 0]]), velocity_mps=np.zeros((1, 3)), score=np.ones(1), track_id=[3]
    )
    view = View(VIEW.x_min_m, VIEW.x_max_m, VIEW.y_min_m, VIEW.y_max_m, pixels_per_metre=5)
    tails = {3: np.array([[0.0, 3.0], [5.0, 3.0]])}
    drawn = np.asarray(
        birds_eye(view, np.zeros((0, 3)), np.zeros(0, int), box, tails, "", [BoxPaint((1, 2, 3), "")])
    )
    assert drawn.shape == (100, 80, 3)
    painted = np.argwhere((drawn == (1, 2, 3)).all(axis=2))
    assert painted[:, 0].min() == pytest.approx((15 - 9) * 5, abs=1)  # the nose, 9 m ahead
    assert painted[:, 0].max() == pytest.approx(15 * 5, abs=1)  # the end of the tail, beside the car
    assert not (drawn == colours.track_colour(3)).all(axis=2).any()
