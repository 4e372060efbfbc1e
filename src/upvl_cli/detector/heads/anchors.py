"""The head with anchors: boxes of a few sizes and two headings a cell (PointPillars, Lang et al., CVPR 2019)."""

from __future__ import annotations

from math import pi

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from upvl_cli.detector.assignment import Assignment, assign_by_overlap
from upvl_cli.detector.config import AnchorsConfig
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.heads.base import cell_centers
from upvl_cli.errors import BadSetting
from upvl_cli.types import Boxes, Floats

_HEADINGS_RAD = (
    0.0,
    pi / 2,
)  # along and across: the angle of any box is within pi/4 of one, up to half a turn


class Anchors:
    """A few sizes and two headings a cell; the heading is an angle up to half a turn and a direction.

    The loss of the angle is the Huber loss of its sine, so that half a turn costs nothing but the direction
    (SECOND, Yan et al., Sensors 2018, Section 3.2).
    """

    def __init__(self, grid: Grid, config: AnchorsConfig) -> None:
        """Lay out the anchors on the ground, z = 0.

        Raises:
            BadSetting: There is no size, or lengths, widths and heights are not equally many.
        """
        counts = {len(config.length_m), len(config.width_m), len(config.height_m)}
        if len(counts) > 1 or not config.length_m:
            raise BadSetting(
                "model.anchors: length_m, width_m and height_m need equally many values, one at least"
            )
        self._config = config
        sizes = [*zip(config.length_m, config.width_m, config.height_m, strict=True)]
        kinds = np.array([[s[2] / 2, *s, heading] for s in sizes for heading in _HEADINGS_RAD])
        cells = cell_centers(grid)
        self.anchors_per_cell = len(kinds)
        center_xy_m = np.repeat(cells, len(kinds), axis=0)
        self.anchors = Boxes.from_rows(np.concatenate([center_xy_m, np.tile(kinds, (len(cells), 1))], axis=1))

    def assign(self, boxes: Boxes) -> Assignment:
        """Return which anchors are positive, by rotated overlap."""
        return assign_by_overlap(self.anchors, boxes, self._config.positive_iou, self._config.negative_iou)

    def encode_heading(self, anchors: Boxes, boxes: Boxes) -> Floats:
        """Return (p, 2): angle from the anchor, -pi / 2 to pi / 2; 1 where the box looks the other way."""
        angle = boxes.heading_rad - anchors.heading_rad
        return np.stack([_half_turn(angle), np.cos(angle) < 0], axis=1)

    def decode_heading(self, anchors: Boxes, code: Floats) -> Floats:
        """Return (p,) headings from -pi to pi."""
        angle = anchors.heading_rad + _half_turn(code[:, 0]) + np.where(code[:, 1] > 0, pi, 0)
        return np.asarray((angle + pi) % (2 * pi) - pi)

    def heading_loss(self, prediction: Tensor, code: Tensor) -> Tensor:
        """Return (p,) Huber losses of the sine of the difference, plus the cross-entropy of the direction."""
        sine = torch.sin(prediction[:, 0] - code[:, 0])
        angle = functional.smooth_l1_loss(sine, torch.zeros_like(sine), reduction="none")
        direction = functional.binary_cross_entropy_with_logits(
            prediction[:, 1], code[:, 1], reduction="none"
        )
        return angle + self._config.direction_weight * direction


def _half_turn(angle: Floats) -> Floats:
    """Return angles brought to -pi / 2 to pi / 2 by half turns."""
    return np.asarray((angle + pi / 2) % pi - pi / 2)
