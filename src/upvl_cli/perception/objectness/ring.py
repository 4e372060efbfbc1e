"""Points around boxes: a wall, a hedge and a slope go on beyond the box around a part of them."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.perception.box_fit import to_heading_axes
from upvl_cli.perception.objectness.config import ObjectnessConfig
from upvl_cli.types import Boxes, Floats, Ints


def ring_counts(xyz_m: Floats, height_m: Floats, boxes: Boxes, config: ObjectnessConfig) -> Ints:
    """Return (b,) points above the ground between an inner and an outer distance from each box.

    Args:
        xyz_m: (n, 3) points of a sweep.
        height_m: (n,) their heights over the ground.
        boxes: b boxes in the same axes.
        config: The distances, and the heights that count.
    """
    low_m, high_m = config.ring_height_m
    beside = xyz_m[(height_m >= low_m) & (height_m <= high_m)]
    inner_m, outer_m = config.ring_m
    box, point = pairs_inside(beside, boxes, margin_m=outer_m)
    offset_m = beside[point] - boxes.center_m[box]
    flat_m = np.abs(to_heading_axes(offset_m[:, :2], boxes.heading_rad[box]))
    beyond_m = np.column_stack([flat_m, np.abs(offset_m[:, 2])]) - boxes.size_lwh_m[box] / 2
    return np.bincount(box[beyond_m.max(axis=1) > inner_m], minlength=len(boxes))
