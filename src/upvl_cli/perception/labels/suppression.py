"""Scores of labels, and the boxes whose size no object has."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.config import BoxScoreConfig, SizeConfig
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints


def box_score(
    objectness: Floats, num_points: Ints, background_share: Floats, config: BoxScoreConfig
) -> Array:
    """Return (n,) confidence from 0 to 1: the likeness of a track to road users, by the points of each of its boxes.

    Neither UP-VL nor MI-UP states a score of auto labels. A box with few points may lie beside its object; one with
    `half_points` counts half. What words call background counts less.

    Args:
        objectness: (n,) probability that the track is a road user.
        num_points: (n,) points of the box in its own frame.
        background_share: (n,) share of background among the points of its track; 0 without words.
        config: Settings.
    """
    support = num_points / (num_points + config.half_points)
    return np.asarray(objectness * support * (1.0 - background_share))


def size_faults(boxes: Boxes, config: SizeConfig) -> dict[str, Bools]:
    """Return which boxes have a size that no object has, by reason; a box has at most one reason.

    Args:
        boxes: n boxes.
        config: The limits; a box on a limit has no fault.
    """
    volume_m3, height_m = boxes.size_lwh_m.prod(axis=1), boxes.size_lwh_m[:, 2]
    flat = ~(height_m >= config.min_height_m)
    small = ~(volume_m3 >= config.min_volume_m3) & ~flat
    large = ~(volume_m3 <= config.max_volume_m3) & ~flat & ~small
    return {"too flat": flat, "too small": small, "too large": large}
