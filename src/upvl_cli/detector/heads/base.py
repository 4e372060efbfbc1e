"""What the two ways to say where a box is have in common: places over the grid, and numbers beside a place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from torch import Tensor

from upvl_cli.detector.batch import Grid
from upvl_cli.types import Array, Floats, Ints

STRIDE = 2  # pillars, along each axis, for one cell of the output
RESIDUAL = 8  # numbers that put a box beside a place: six of place and size, two of heading
_LARGEST_LOG = 4.0  # sizes up to e^4 = 55 times the place's; beyond, a wild answer would be infinite


@dataclass(frozen=True)
class Assigned:
    """What the places of one frame have to answer.

    Attributes:
        weight: (k,) how much the objectness of each place counts: 1, less, or 0 where it does not matter.
        place: (p,) the places that stand for a box, ascending.
        box: (p,) which box that is.
    """

    weight: Floats
    place: Ints
    box: Ints


class Head(Protocol):
    """One way to say where boxes are.

    Attributes:
        places: (k, 7) boxes that a residual of zeros says, up to heading; by x, then y, then within the cell.
        each_cell: How many places a cell of the output has.
    """

    places: Floats
    each_cell: int

    def assign(self, boxes: Array) -> Assigned:
        """Say which places stand for which of (m, 7) boxes."""
        ...

    def heading_code(self, places: Floats, boxes: Array) -> Floats:
        """(p, 2) numbers that say the heading of each of (p, 7) boxes at its place."""
        ...

    def heading(self, places: Floats, code: Floats) -> Floats:
        """(p,) headings from what `heading_code` gave, or the network."""
        ...

    def heading_loss(self, said: Tensor, code: Tensor) -> Tensor:
        """(p,) how wrong the (p, 2) numbers of the network are."""
        ...


def cell_centres(grid: Grid) -> Floats:
    """(cells, 2) x and y of the middle of each cell of the output, by x, then y."""
    side = STRIDE * grid.pillar_m
    along, across = (side * (np.arange(count // STRIDE) + 0.5) for count in grid.shape)
    x, y = np.meshgrid(grid.x_m[0] + along, grid.y_m[0] + across, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def encode(head: Head, places: Floats, boxes: Array) -> Floats:
    """(p, RESIDUAL) numbers that say each of (p, 7) boxes at its place (SECOND, Yan et al., Sensors 2018)."""
    reach = np.hypot(places[:, 3], places[:, 4])
    scale = np.stack([reach, reach, places[:, 5]], axis=1)
    offset, size = (boxes[:, :3] - places[:, :3]) / scale, np.log(boxes[:, 3:6] / places[:, 3:6])
    return np.concatenate([offset, size, head.heading_code(places, boxes)], axis=1)


def decode(head: Head, places: Floats, residual: Array) -> Floats:
    """(p, 7) boxes from (p, RESIDUAL) numbers: undoes `encode`."""
    residual = np.asarray(residual, dtype=np.float64)
    reach = np.hypot(places[:, 3], places[:, 4])
    scale = np.stack([reach, reach, places[:, 5]], axis=1)
    centre = residual[:, :3] * scale + places[:, :3]
    size = np.exp(np.clip(residual[:, 3:6], -_LARGEST_LOG, _LARGEST_LOG)) * places[:, 3:6]
    return np.column_stack([centre, size, head.heading(places, residual[:, 6:])])
