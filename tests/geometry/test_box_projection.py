"""Rectangles around projected boxes: counted by hand, against single points, and through a lens."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.geometry.box_projection import iou_of_rectangles, projected_boxes
from upvl_cli.geometry.boxes import corners
from upvl_cli.geometry.camera import project
from upvl_cli.types import Boxes, Camera

# Looks along x: its z is the car's x, its x is right, its y is down.
FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def camera(distortion: tuple[float, ...] = (0, 0, 0, 0, 0)) -> Camera:
    intrinsic = np.array([[100.0, 0, 99.5], [0, 100, 49.5], [0, 0, 1]])
    return Camera("front", 200, 100, intrinsic, np.array(distortion), FORWARD)


def boxes(*rows: list[float]) -> np.ndarray:
    return corners(Boxes.from_rows(np.array(rows)))


def test_a_box_ahead_is_its_near_face() -> None:
    """The near face of a cube of 2 m whose centre is 11 m ahead is 20 px wide at 10 m."""
    edges, share = projected_boxes(camera(), boxes([11.0, 0, 0, 2, 2, 2, 0]))
    np.testing.assert_allclose(edges, [[89.5, 39.5, 109.5, 59.5]])
    assert share.tolist() == [1.0]


def test_a_box_across_the_border_is_clipped_and_its_share_is_by_area() -> None:
    edges, share = projected_boxes(camera(), boxes([11.0, 10, 0, 2, 2, 2, 0]))
    # At 10 m its left side, 11 m to the left, lies at -10.5 px; its right side, 9 m at 12 m, at 24.5 px.
    np.testing.assert_allclose(edges, [[-0.5, 39.5, 24.5, 59.5]])
    np.testing.assert_allclose(share, [25 / 35])


@pytest.mark.parametrize("row", [[-11.0, 0, 0, 2, 2, 2, 0], [11, 30, 0, 2, 2, 2, 0], [11, 0, 90, 2, 2, 2, 0]])
def test_what_is_behind_or_beside_is_not_in_view(row: list[float]) -> None:
    edges, share = projected_boxes(camera(), boxes(row))
    assert np.isnan(edges).all() and share.tolist() == [0.0]


def test_a_box_around_the_camera_fills_the_picture() -> None:
    """A bus beside the camera reaches from behind it to 8 m ahead."""
    edges, share = projected_boxes(camera(), boxes([0.0, 3, 0, 16, 2.5, 3, 0]))
    assert edges[0, 0] == -0.5 and edges[0, 2] == pytest.approx(99.5 - 100 * 1.75 / 8)
    assert 0 < share[0] < 1


def test_a_bent_edge_counts_as_the_lens_shows_it() -> None:
    """A barrel bows the middle of a long edge outwards: the corners alone would miss it."""
    bent = camera((-0.2, 0, 0, 0, 0))
    cube = boxes([6.0, 0, 1.5, 0.01, 8, 2, 0])
    edges, _ = projected_boxes(bent, cube)
    only_corners = project(bent, cube[0])[0]
    assert edges[0, 1] < only_corners[:, 1].min() - 1
    assert edges[0, 3] == pytest.approx(only_corners[:, 1].max(), abs=3)


def test_no_boxes() -> None:
    edges, share = projected_boxes(camera(), np.zeros((0, 8, 3)))
    assert edges.shape == (0, 4) and share.shape == (0,)


def test_iou_of_rectangles_counted_by_hand() -> None:
    first = np.array([[0.0, 0, 4, 4], [np.nan] * 4, [0, 0, 2, 2]])
    second = np.array([[2.0, 2, 6, 6], [0, 0, 4, 4], [4, 0, 8, 4]])
    np.testing.assert_allclose(iou_of_rectangles(first, second), [[4 / 28, 1, 0], [0, 0, 0], [0, 4 / 16, 0]])
    assert iou_of_rectangles(first, second[:0]).shape == (3, 0)
