"""What the heads have in common: anchors over the grid, and residuals that put a box beside its anchor."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from torch import Tensor

from upvl_cli.detector.assignment import Assignment
from upvl_cli.detector.grid import Grid
from upvl_cli.types import Array, Boxes, Floats

STRIDE = 2  # pillars, along each axis, for one cell of the output
BOX_DIMS = slice(0, 6)  # of a residual: offset of the centre (3), logarithm of the size (3)
HEADING_DIMS = slice(6, 8)  # of a residual: two numbers that each head defines
RESIDUAL_DIM = 8
_MAX_LOG_SIZE = (
    4.0  # sizes up to e^4 = 55 times the anchor's: the exponential of an untrained output overflows
)


class Head(Protocol):
    """One way to encode boxes.

    Attributes:
        anchors: (k) boxes that a residual of zeros decodes to, up to heading; by x, then y, then within the cell.
        anchors_per_cell: How many anchors a cell of the output has.
    """

    anchors: Boxes
    anchors_per_cell: int

    def assign(self, boxes: Boxes) -> Assignment:
        """Return which anchors are positive, and for which boxes."""
        ...

    def encode_heading(self, anchors: Boxes, boxes: Boxes) -> Floats:
        """Return (p, 2) numbers for the heading of each box beside the anchor of the same row."""
        ...

    def decode_heading(self, anchors: Boxes, code: Floats) -> Floats:
        """Return (p,) headings from (p, 2) numbers of `encode_heading` or of the network."""
        ...

    def heading_loss(self, prediction: Tensor, code: Tensor) -> Tensor:
        """Return (p,) losses of the (p, 2) numbers of the network against those of `encode_heading`."""
        ...


def cell_centers(grid: Grid) -> Floats:
    """Return (cells, 2) x and y of the centre of each cell of the output, by x, then y."""
    side_m = STRIDE * grid.pillar_m
    along, across = (side_m * (np.arange(count // STRIDE) + 0.5) for count in grid.shape)
    x, y = np.meshgrid(grid.x_m[0] + along, grid.y_m[0] + across, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def encode(head: Head, anchors: Boxes, boxes: Boxes) -> Floats:
    """Return (p, RESIDUAL_DIM) residuals of boxes beside the anchors of the same rows.

    Offsets are in diagonals of the anchor (vertically in its height), sizes are logarithms of ratios
    (SECOND, Yan et al., Sensors 2018, eq. 1).
    """
    offset = (boxes.center_m - anchors.center_m) / _offset_scale_m(anchors)
    size = np.log(boxes.size_lwh_m / anchors.size_lwh_m)
    return np.concatenate([offset, size, head.encode_heading(anchors, boxes)], axis=1)


def decode(head: Head, anchors: Boxes, residual: Array) -> Boxes:
    """Return the boxes of (p, RESIDUAL_DIM) residuals beside the anchors of the same rows: undoes `encode`."""
    residual = np.asarray(residual, dtype=np.float64)
    center_m = residual[:, :3] * _offset_scale_m(anchors) + anchors.center_m
    log_size = np.clip(residual[:, 3:6], -_MAX_LOG_SIZE, _MAX_LOG_SIZE)
    return Boxes(
        center_m,
        np.exp(log_size) * anchors.size_lwh_m,
        head.decode_heading(anchors, residual[:, HEADING_DIMS]),
    )


def _offset_scale_m(anchors: Boxes) -> Floats:
    """Return (p, 3) units of the offsets: the anchor's diagonal seen from above, twice, and its height."""
    length_m, width_m, height_m = anchors.size_lwh_m.T
    diagonal_m = np.hypot(length_m, width_m)
    return np.stack([diagonal_m, diagonal_m, height_m], axis=1)
