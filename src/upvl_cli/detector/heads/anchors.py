"""Places with a size and a heading, for any class of object (PointPillars, Lang et al., CVPR 2019)."""

from __future__ import annotations

from math import pi

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from upvl_cli.detector.batch import Grid
from upvl_cli.detector.head import Assigned, cell_centres
from upvl_cli.detector.targets import assign
from upvl_cli.types import Array, Floats

_SIZES = ((4.5, 1.9, 1.6), (9.0, 2.8, 3.2), (1.8, 0.7, 1.7), (0.9, 0.7, 1.7))  # m: car, truck, rider, walker
_HEADINGS = (0.0, pi / 2)
_DIRECTION = 0.2  # weight of the direction beside the angle (SECOND, Yan et al., Sensors 2018)


class Anchors:
    """A few sizes and two headings a cell; heading as an angle up to half a turn, and which of its two ends.

    The loss of the angle is the Huber loss of its sine, so that a box turned by half a turn costs nothing
    but its direction, and no angle stands at a jump.
    """

    each_cell = len(_SIZES) * len(_HEADINGS)

    def __init__(self, grid: Grid) -> None:
        """Lay out the places: all stand on the ground, z = 0."""
        kinds = np.array([[s[2] / 2, *s, heading] for s in _SIZES for heading in _HEADINGS])
        cells = cell_centres(grid)
        every = np.repeat(cells, len(kinds), axis=0)
        self.places: Floats = np.concatenate([every, np.tile(kinds, (len(cells), 1))], axis=1)

    def assign(self, boxes: Array) -> Assigned:
        """By rotated overlap."""
        return assign(self.places, boxes)

    def heading_code(self, places: Floats, boxes: Array) -> Floats:
        """(p, 2) angle from the anchor up to half a turn, from -pi / 2 to pi / 2; 1 where the box looks back."""
        angle = boxes[:, 6] - places[:, 6]
        return np.stack([_half_turn(angle), np.cos(angle) < 0], axis=1)

    def heading(self, places: Floats, code: Floats) -> Floats:
        """(p,) heading from -pi to pi."""
        angle = places[:, 6] + _half_turn(code[:, 0]) + np.where(code[:, 1] > 0, pi, 0)
        return np.asarray((angle + pi) % (2 * pi) - pi)

    def heading_loss(self, said: Tensor, code: Tensor) -> Tensor:
        """(p,) Huber of the sine of the difference, and cross-entropy of the direction."""
        sine = torch.sin(said[:, 0] - code[:, 0])
        angle = functional.smooth_l1_loss(sine, torch.zeros_like(sine), reduction="none")
        direction = functional.binary_cross_entropy_with_logits(said[:, 1], code[:, 1], reduction="none")
        return angle + _DIRECTION * direction


def _half_turn(angle: Floats) -> Floats:
    return np.asarray((angle + pi / 2) % pi - pi / 2)
