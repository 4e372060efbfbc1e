"""Scores of labels, and the boxes whose size no object has."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.config import SizeConfig, SupportScoreConfig
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints


def support_score(
    num_points: Ints, num_frames: Ints, background_share: Floats, config: SupportScoreConfig
) -> Array:
    """Return (n,) confidence from 0 to 1: the support of a box by points and frames, less its background.

    Neither UP-VL nor MI-UP states a score of auto labels; support is what is known without human labels. Each
    of both parts saturates, x / (x + half), so that scores spread over the cut-offs of the metrics.

    Args:
        num_points: (n,) points of the box in its own frame.
        num_frames: (n,) frames in which its track was seen.
        background_share: (n,) share of background among the points of its track.
        config: Where each part is one half.
    """
    support = num_points / (num_points + config.half_points) * num_frames / (num_frames + config.half_frames)
    return np.asarray(support * (1.0 - background_share))


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
