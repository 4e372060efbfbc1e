"""Reduced pictures, and the edges of boxes in them."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from upvl_cli.types import Boxes, Camera
from upvl_cli.viewer.pictures import box_edges, jpeg, reduction, size_of

# Looks along x from the origin, 100 pixels a unit of slope; the first pixel has its centre at (0, 0).
AHEAD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def camera(distortion: tuple[float, ...] = (0.0,) * 5) -> Camera:
    intrinsic = np.array([[100.0, 0, 99.5], [0, 100, 49.5], [0, 0, 1]])
    return Camera("front", 200, 100, intrinsic, np.array(distortion), AHEAD)


def test_a_picture_is_reduced_to_its_longer_side() -> None:
    assert reduction(camera(), None) == 1.0
    assert reduction(camera(), 400) == 1.0
    assert size_of(camera(), reduction(camera(), 50)) == (50, 25)
    grey = np.full((100, 200, 3), 77, np.uint8)
    small = Image.open(io.BytesIO(jpeg(grey, (50, 25))))
    assert (small.format, small.size) == ("JPEG", (50, 25))
    assert abs(int(np.asarray(small).mean()) - 77) <= 1


def test_edges_stand_where_the_box_is_seen() -> None:
    # Near face 4 m ahead, 2 m wide and high: 50 pixels each, from the corner of the picture (75, 25) to (125, 75).
    box = Boxes(np.array([[5.0, 0, 0]]), np.array([[2.0, 2, 2]]), np.zeros(1))
    edges = box_edges(camera(), box, 1.0)
    assert len(edges.strips_px) == 12
    assert set(edges.box) == {0}
    every = np.concatenate(edges.strips_px)
    np.testing.assert_allclose([every.min(axis=0), every.max(axis=0)], [[75, 25], [125, 75]])
    assert edges.anchor_px[0][1] == 25
    np.testing.assert_allclose(np.concatenate(box_edges(camera(), box, 0.5).strips_px), every / 2)


def test_a_lens_bends_edges() -> None:
    box = Boxes(np.array([[5.0, 0, 0]]), np.array([[2.0, 2, 2]]), np.zeros(1))
    straight, bent = box_edges(camera(), box, 1.0), box_edges(camera((-0.3, 0, 0, 0, 0)), box, 1.0)
    for plain, curved in zip(straight.strips_px, bent.strips_px, strict=True):
        assert len(plain) == len(curved) > 2
    assert np.abs(np.concatenate(straight.strips_px) - np.concatenate(bent.strips_px)).max() > 0.9


def test_what_the_camera_does_not_see_has_no_edge() -> None:
    centers = np.array([[-5.0, 0, 0], [5.0, 40, 0], [0.0, 0, 0], [6.0, 0, 0]])
    boxes = Boxes(centers, np.full((4, 3), 2.0), np.zeros(4))
    edges = box_edges(camera(), boxes, 1.0)
    assert set(edges.box) <= {2, 3}
    assert set(edges.anchor_px) <= {2, 3} and 3 in edges.anchor_px
    assert np.isfinite(np.concatenate(edges.strips_px)).all()
    nothing = box_edges(camera(), boxes[:0], 1.0)
    assert (nothing.strips_px, nothing.box, nothing.anchor_px) == ([], [], {})
