"""Places without a size: the cell under the middle of a box says it (CenterPoint, Yin et al., CVPR 2021)."""

from __future__ import annotations

import numpy as np
from torch import Tensor
from torch.nn import functional

from upvl_cli.detector.batch import Grid
from upvl_cli.detector.head import STRIDE, Assigned, cell_centres
from upvl_cli.types import Array, Floats

_TYPICAL = (3.0, 1.5, 1.6)  # m; between a walker and a car, so that residuals of sizes are near 0
_MIDDLE_Z_M = 0.9
_SPREAD = 0.2  # of a side: how far from its middle a box still excuses a cell that says "here"
_EXPONENT = 4  # of the excuse (CornerNet, Law and Deng, ECCV 2018)


class Centres:
    """One place a cell; heading as sine and cosine."""

    each_cell = 1

    def __init__(self, grid: Grid) -> None:
        """Lay out the places."""
        cells = cell_centres(grid)
        rest = np.tile([_MIDDLE_Z_M, *_TYPICAL, 0.0], (len(cells), 1))
        self.places: Floats = np.concatenate([cells, rest], axis=1)
        self._side_m = STRIDE * grid.pillar_m
        self._origin = np.array([grid.x_m[0], grid.y_m[0]])
        self._shape = np.array(grid.shape) // STRIDE

    def assign(self, boxes: Array) -> Assigned:
        """The cell under the middle of a box stands for it; of two boxes in one cell, for the later one.

        The nearer another cell is to the middle, in sizes of the box, the less its objectness counts.
        """
        weight = np.ones(len(self.places), dtype=np.float32)
        for box in boxes:
            weight = np.minimum(weight, self._excused(box))
        cell = np.floor((boxes[:, :2] - self._origin) / self._side_m).astype(np.int64)
        cell = np.clip(cell, 0, self._shape - 1)
        owner = np.full(len(self.places), -1)
        owner[cell[:, 0] * self._shape[1] + cell[:, 1]] = np.arange(len(boxes))
        place = np.flatnonzero(owner >= 0)
        weight[place] = 1
        return Assigned(weight, place, owner[place])

    def _excused(self, box: Array) -> Floats:
        """(k,) weights beside one box."""
        dx, dy = (self.places[:, :2] - box[:2]).T
        cos, sin = np.cos(box[6]), np.sin(box[6])
        along, across = (dx * cos + dy * sin) / box[3], (dy * cos - dx * sin) / box[4]
        near = np.exp(-(along * along + across * across) / (2 * _SPREAD * _SPREAD))
        return np.asarray((1 - near) ** _EXPONENT, dtype=np.float32)

    def heading_code(self, places: Floats, boxes: Array) -> Floats:
        """(p, 2) sine and cosine."""
        return np.stack([np.sin(boxes[:, 6]), np.cos(boxes[:, 6])], axis=1)

    def heading(self, places: Floats, code: Floats) -> Floats:
        """(p,) heading from -pi to pi."""
        return np.arctan2(code[:, 0], code[:, 1])

    def heading_loss(self, said: Tensor, code: Tensor) -> Tensor:
        """(p,) Huber of both numbers."""
        return functional.smooth_l1_loss(said, code, reduction="none").sum(dim=1)
