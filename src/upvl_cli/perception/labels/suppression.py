"""Which boxes stay: the better of two that overlap, and none that no object could fill."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.iou import iou_bev
from upvl_cli.types import Array, Bools, Floats, Ints

FRAMES_HALF = 4.0  # a track seen in this many frames is half sure, many times that nearly sure
POINTS_HALF = 15.0  # the same of a box with this many points


def support_score(points: Ints, frames: Ints, background: Floats) -> Array:
    """(n,) confidence from 0 to 1: how much was seen of a box and of its track, less what words say against it.

    Neither paper says how auto labels are scored; support is what is known without labels. It is
    smooth, so that scores spread over the cut-offs of the metrics.

    Args:
        points: (n,) points of the box in its own frame.
        frames: (n,) frames in which its track was seen.
        background: (n,) share of background among the points of its track.
    """
    support = points / (points + POINTS_HALF) * frames / (frames + FRAMES_HALF)
    return np.asarray(support * (1.0 - background))


def suppress(seven: Floats, score: Floats, *, max_iou: float) -> Bools:
    """(n,) which boxes stay when of two that overlap more the one of lower score goes.

    Greedy, by falling score, ties by row (Algorithm 1, last step; rotated, seen from above).

    Args:
        seven: (n, 7) boxes of one frame.
        score: (n,) their confidence.
        max_iou: Bird's-eye IoU above which two boxes are one object.
    """
    kept = np.ones(len(seven), dtype=np.bool_)
    rivals = iou_bev(seven, seven) > max_iou
    for box in np.argsort(-np.asarray(score), kind="stable"):
        if kept[box]:
            kept &= ~rivals[box]
            kept[box] = True
    return kept


def wrong_size(
    seven: Floats, *, min_volume_m3: float, max_volume_m3: float, min_height_m: float
) -> dict[str, Bools]:
    """Which boxes no object could fill, by reason; a box has at most one.

    There is no limit on length: buses and trams are long.

    Args:
        seven: (n, 7) boxes.
        min_volume_m3: Smaller is too small.
        max_volume_m3: Larger is too large.
        min_height_m: Lower is too flat.
    """
    volume = seven[:, 3:6].prod(axis=1)
    flat = ~(seven[:, 5] >= min_height_m)
    small = ~(volume >= min_volume_m3) & ~flat
    large = ~(volume <= max_volume_m3) & ~flat & ~small
    return {"too flat": flat, "too small": small, "too large": large}
