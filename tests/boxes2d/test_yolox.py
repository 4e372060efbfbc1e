"""The head of YOLOX: boxes by construction, tiles that cover a picture, and suppression against a plain loop."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.boxes2d.yolox import (
    PADDING,
    STRIDES,
    cell_count,
    decode,
    edges_of_centers,
    is_cut,
    suppress,
    tiles,
    to_picture,
)

RANDOM = np.random.default_rng(5)


def test_a_cell_gives_its_box() -> None:
    """In a 64 x 96 input the grids have 8 x 12, 4 x 6 and 2 x 3 cells."""
    assert cell_count(64, 96) == 96 + 24 + 6
    output = np.zeros((126, 4))
    output[1 * 12 + 2] = [0.5, 0.25, np.log(2), np.log(3)]  # stride 8, row 1, column 2
    output[96 + 3 * 6 + 5] = [0, 0, 0, 0]  # stride 16, row 3, column 5
    output[120 + 1 * 3 + 0] = [1, 0, np.log(0.5), 1000.0]  # stride 32, row 1, column 0; no overflow
    edges = decode(output, 64, 96)
    np.testing.assert_allclose(edges[14], [20 - 8, 10 - 12, 20 + 8, 10 + 12])
    np.testing.assert_allclose(edges[96 + 23], [72, 40, 88, 56])
    np.testing.assert_allclose(edges[123][[0, 2]], [24, 40])
    assert np.isfinite(edges).all()


def test_boxes_in_pixels_are_taken_as_they_are() -> None:
    np.testing.assert_allclose(edges_of_centers(np.array([[10.0, 20, 4, 6, 9]])), [[8, 17, 12, 23]])


@pytest.mark.parametrize(
    ("size", "scales", "expected"),
    [
        ((64, 64), (1.0,), 1),  # the entire picture is native already
        ((40, 50), (1.0,), 1),  # enlarged by 1.28: native is less
        ((64, 160), (1.0,), 1 + 3),  # steps of 51: 0, 48, 96
        ((128, 128), (1.0, 0.5), 1 + 9),  # half the size is the entire picture
        ((64, 160), (), 1),
    ],
)
def test_tiles_cover_every_pixel_at_each_scale(
    size: tuple[int, int], scales: tuple[float, ...], expected: int
) -> None:
    rgb = RANDOM.integers(0, 256, (*size, 3), dtype=np.uint8)
    found = list(tiles(rgb, 64, 64, scales, 0.2))
    assert len(found) == expected
    covered = np.zeros(size, dtype=bool)
    for tile in found[1:]:
        top, left = tile.top_px, tile.left_px
        covered[top : top + 64, left : left + 64] = True
        np.testing.assert_array_equal(
            tile.pixels, rgb[top : top + 64, left : left + 64, ::-1].transpose(2, 0, 1)
        )
        assert tile.cut_ltrb.tolist() == [left > 0, top > 0, left + 64 < size[1], top + 64 < size[0]]
    assert covered.all() or expected == 1
    assert not found[0].cut_ltrb.any()


def test_a_small_picture_lies_in_the_corner_on_grey() -> None:
    (tile,) = tiles(np.full((16, 64, 3), 7, np.uint8), 64, 64, (1.0,), 0.2)
    assert (tile.pixels[:, :16] == 7).all() and (tile.pixels[:, 16:] == PADDING).all()


def test_a_box_comes_back_from_its_tile_to_the_picture() -> None:
    """A picture twice as wide as the input is halved; a native tile is shifted."""
    entire, *native = tiles(np.zeros((128, 128, 3), np.uint8), 64, 64, (1.0,), 0.0)
    np.testing.assert_allclose(to_picture(np.array([[1.0, 2, 3, 4]]), entire), [[2, 4, 6, 8]])
    last = native[-1]
    assert (last.left_px, last.top_px) == (64, 64)
    np.testing.assert_allclose(to_picture(np.array([[1.0, 2, 3, 4]]), last), [[65, 66, 67, 68]])


def test_what_an_inner_edge_cuts_is_left_to_the_next_tile() -> None:
    first = list(tiles(np.zeros((64, 160, 3), np.uint8), 64, 64, (1.0,), 0.2))[1]
    edges = np.array([[0.0, 10, 20, 30], [40, 10, 62, 30], [10, -1, 20, 66], [40, 10, 60, 30]])
    # The left, upper and lower edges are those of the picture.
    assert is_cut(edges, first).tolist() == [False, True, False, False]


def plain_suppress(edges: np.ndarray, score: np.ndarray, kind: np.ndarray, max_iou: float) -> list[int]:
    kept: list[int] = []
    for row in sorted(range(len(score)), key=lambda row: (-score[row], row)):
        better = [
            other for other in kept if kind[other] == kind[row] and iou(edges[row], edges[other]) > max_iou
        ]
        if not better:
            kept.append(row)
    return kept


def iou(a: np.ndarray, b: np.ndarray) -> float:
    wide, high = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    shared = max(wide, 0) * max(high, 0)
    return shared / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - shared)


@pytest.mark.parametrize("max_iou", [0.0, 0.3, 0.6, 1.0])
def test_suppression_is_that_of_a_plain_loop(max_iou: float) -> None:
    corner = RANDOM.uniform(0, 30, (60, 2))
    edges = np.hstack([corner, corner + RANDOM.uniform(3, 20, (60, 2))])
    score = np.round(RANDOM.uniform(0, 1, 60), 1)  # with equal ones
    kind = RANDOM.integers(0, 3, 60)
    assert suppress(edges, score, kind, max_iou).tolist() == plain_suppress(edges, score, kind, max_iou)


def test_nothing_is_suppressed_to_nothing() -> None:
    assert len(suppress(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64), 0.5)) == 0


def test_strides_are_those_of_the_paper() -> None:
    assert STRIDES == (8, 16, 32)
