"""The head without anchors: the cell under the centre of a box predicts it (CenterPoint, Yin et al., CVPR 2021)."""

from __future__ import annotations

import numpy as np
from torch import Tensor
from torch.nn import functional

from upvl_cli.detector.assignment import Assignment
from upvl_cli.detector.config import CentersConfig
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.heads.base import STRIDE, cell_centers
from upvl_cli.types import Array, Boxes, Floats


class Centers:
    """One anchor a cell, of one size; the heading is its sine and cosine."""

    anchors_per_cell = 1

    def __init__(self, grid: Grid, config: CentersConfig) -> None:
        """Lay out the anchors, one at the centre of each cell."""
        self._config = config
        cells = cell_centers(grid)
        rest = [config.center_z_m, config.length_m, config.width_m, config.height_m, 0.0]
        self.anchors = Boxes.from_rows(np.concatenate([cells, np.tile(rest, (len(cells), 1))], axis=1))
        self._side_m = STRIDE * grid.pillar_m
        self._origin_m = np.array([grid.x_m[0], grid.y_m[0]])
        self._shape = np.array(grid.shape) // STRIDE

    def assign(self, boxes: Boxes) -> Assignment:
        """Return the cell under the centre of each box as positive; of two boxes in a cell the later one has it.

        The nearer another cell is to the centre, in sides of the box, the less its objectness weighs.
        """
        weight = np.ones(len(self.anchors), dtype=np.float32)
        for row in boxes.to_rows():
            weight = np.minimum(weight, self._negative_weight(row))
        cell = np.floor((boxes.center_m[:, :2] - self._origin_m) / self._side_m).astype(np.int64)
        cell = np.clip(cell, 0, self._shape - 1)
        owner = np.full(len(self.anchors), -1)
        owner[cell[:, 0] * self._shape[1] + cell[:, 1]] = np.arange(len(boxes))
        anchor = np.flatnonzero(owner >= 0)
        weight[anchor] = 1
        return Assignment(weight, anchor, owner[anchor])

    def _negative_weight(self, box: Array) -> Floats:
        """Return (k,) weights of negative cells around a box, (1 - Gaussian)^e (CornerNet, Law and Deng, ECCV 2018)."""
        x, y, _, length, width, _, heading = box
        dx, dy = (self.anchors.center_m[:, :2] - [x, y]).T
        cos, sin = np.cos(heading), np.sin(heading)
        along, across = (dx * cos + dy * sin) / length, (dy * cos - dx * sin) / width
        sigma = self._config.heatmap_sigma
        gaussian = np.exp(-(along * along + across * across) / (2 * sigma * sigma))
        return np.asarray((1 - gaussian) ** self._config.heatmap_exponent, dtype=np.float32)

    def encode_heading(self, anchors: Boxes, boxes: Boxes) -> Floats:
        """Return (p, 2) sine and cosine."""
        return np.stack([np.sin(boxes.heading_rad), np.cos(boxes.heading_rad)], axis=1)

    def decode_heading(self, anchors: Boxes, code: Floats) -> Floats:
        """Return (p,) headings from -pi to pi."""
        return np.arctan2(code[:, 0], code[:, 1])

    def heading_loss(self, prediction: Tensor, code: Tensor) -> Tensor:
        """Return (p,) Huber losses of sine and cosine, summed."""
        return functional.smooth_l1_loss(prediction, code, reduction="none").sum(dim=1)
