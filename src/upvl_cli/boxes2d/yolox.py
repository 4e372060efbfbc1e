"""The head of YOLOX: from its numbers to boxes, and where in a picture it looks.

Ge et al., YOLOX: Exceeding YOLO Series in 2021, arXiv 2107.08430: one anchor-free prediction for each cell of
three grids, each with a centre, a size, an objectness and a score for each kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from PIL import Image

from upvl_cli.types import Array, Floats, Ints

STRIDES = (8, 16, 32)
PADDING = 114  # grey of what lies beside a picture, in training too
_CUT_PX = 3.0  # a box that ends this close to the edge of a tile is cut by it
_MAX_LOG_SIZE = 20.0  # e^20 strides: beyond any picture, and far from overflow


@dataclass(frozen=True)
class Tile:
    """A part of a picture as the network sees it.

    Attributes:
        left_px: First column of the part, in the pixels of the enlarged or reduced picture.
        top_px: First row.
        scale_xy: (2,) size of the enlarged or reduced picture over the picture's own, across and down.
        cut_ltrb: (4,) whether the picture goes on beyond the left, top, right and bottom edge.
        pixels: (3, high, wide) float32 blue, green and red, 0 to 255.
    """

    left_px: int
    top_px: int
    scale_xy: Array
    cut_ltrb: Array
    pixels: Array


def cell_count(high_px: int, wide_px: int) -> int:
    """Return how many cells the grids of an input have together."""
    return sum((high_px // stride) * (wide_px // stride) for stride in STRIDES)


def decode(output: Array, high_px: int, wide_px: int) -> Floats:
    """Return (c, 4) left, top, right and bottom edge of the box of each cell, in input pixels from the corner.

    Args:
        output: (c, 4 + ...) of each cell, grid by grid and row by row: centre from the cell's corner in strides,
            and the logarithm of width and height in strides.
        high_px: Height of the input.
        wide_px: Width of the input.
    """
    corner, stride = [], []
    for step in STRIDES:
        row, column = np.mgrid[: high_px // step, : wide_px // step]
        corner.append(np.column_stack([column.ravel(), row.ravel()]))
        stride.append(np.full(row.size, step))
    each = np.concatenate(stride)[:, None].astype(np.float64)
    center = (output[:, :2] + np.concatenate(corner)) * each
    half = np.exp(np.minimum(output[:, 2:4], _MAX_LOG_SIZE)) * each / 2
    return np.hstack([center - half, center + half])


def edges_of_centers(output: Array) -> Floats:
    """Return (c, 4) edges of boxes that a graph gives as centre and size in input pixels."""
    half = output[:, 2:4].astype(np.float64) / 2
    return np.hstack([output[:, :2] - half, output[:, :2] + half])


def tiles(
    rgb: Array, high_px: int, wide_px: int, scales: tuple[float, ...], overlap: float
) -> Iterator[Tile]:
    """Yield the entire picture reduced to the input, then tiles of it at each scale.

    A scale at which the picture is no larger than the entire one is left out.

    Args:
        rgb: (height, width, 3) uint8 picture.
        high_px: Height of the input.
        wide_px: Width of the input.
        scales: Scales at which tiles are cut.
        overlap: Overlap of neighbors as a share of their side.
    """
    height_px, width_px, _ = rgb.shape
    fit = min(high_px / height_px, wide_px / width_px)
    yield from _tiles_at(rgb, fit, (high_px, wide_px), overlap)
    for scale in scales:
        if scale > fit:
            yield from _tiles_at(rgb, scale, (high_px, wide_px), overlap)


def _tiles_at(rgb: Array, scale: float, size_px: tuple[int, int], overlap: float) -> Iterator[Tile]:
    height_px, width_px, _ = rgb.shape
    high, wide = (max(1, round(side * scale)) for side in (height_px, width_px))
    picture = rgb
    if (high, wide) != (height_px, width_px):
        picture = np.asarray(Image.fromarray(rgb).resize((wide, high), Image.Resampling.BILINEAR))
    scale_xy = np.array([wide / width_px, high / height_px])
    for top in _starts(high, size_px[0], overlap):
        for left in _starts(wide, size_px[1], overlap):
            part = picture[top : top + size_px[0], left : left + size_px[1], ::-1]
            pixels = np.full((*size_px, 3), PADDING, dtype=np.float32)
            pixels[: part.shape[0], : part.shape[1]] = part
            goes_on = [left > 0, top > 0, left + size_px[1] < wide, top + size_px[0] < high]
            yield Tile(
                left, top, scale_xy, np.array(goes_on), np.ascontiguousarray(pixels.transpose(2, 0, 1))
            )


def _starts(length: int, tile: int, overlap: float) -> list[int]:
    """Return where tiles begin that cover a length evenly and overlap by a share of their side at least."""
    if length <= tile:
        return [0]
    step = max(1, int(tile * (1 - overlap)))
    number = -(-(length - tile) // step) + 1
    return [round(place) for place in np.linspace(0, length - tile, number)]


def is_cut(edges_px: Floats, tile: Tile) -> Array:
    """Return (n,) whether the edge of a tile cuts a box, so that a neighbor shows more of it.

    Args:
        edges_px: (n, 4) edges in the pixels of the tile.
        tile: The tile.
    """
    _, high, wide = tile.pixels.shape
    beyond = np.hstack([edges_px[:, :2] <= _CUT_PX, edges_px[:, 2:] >= np.array([wide, high]) - _CUT_PX])
    return np.asarray((beyond & tile.cut_ltrb).any(axis=1))


def to_picture(edges_px: Floats, tile: Tile) -> Floats:
    """Return (n, 4) edges in the picture, from its corner, of boxes in the pixels of a tile."""
    moved = edges_px + np.tile([tile.left_px, tile.top_px], 2)
    return np.asarray(moved / np.tile(tile.scale_xy, 2))


def suppress(edges_px: Floats, score: Floats, kind: Ints, max_iou: float) -> Ints:
    """Return the boxes that stay, best first: of two of one kind that overlap the better one.

    Args:
        edges_px: (n, 4) left, top, right and bottom edge.
        score: (n,) confidence.
        kind: (n,) number of the kind.
        max_iou: IoU above which the lower score is dropped.
    """
    order = np.lexsort((np.arange(len(score)), -score))
    kept: list[int] = []
    while len(order):
        best, order = int(order[0]), order[1:]
        kept.append(best)
        inner = np.minimum(edges_px[best, 2:], edges_px[order, 2:]) - np.maximum(
            edges_px[best, :2], edges_px[order, :2]
        )
        shared = np.maximum(inner, 0).prod(axis=1)
        area = (edges_px[order, 2:] - edges_px[order, :2]).prod(axis=1)
        union = area + (edges_px[best, 2:] - edges_px[best, :2]).prod() - shared
        order = order[(kind[order] != kind[best]) | (shared <= max_iou * union)]
    return np.array(kept, dtype=np.int64)
