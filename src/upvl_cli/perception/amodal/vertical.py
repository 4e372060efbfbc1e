"""How high an object is, and where it stands."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import percentile_filter

from upvl_cli.perception.amodal.config import AmodalFitConfig
from upvl_cli.perception.amodal.edges import attained
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.types import Array


def vertical_extent(seen: Sightings, config: AmodalFitConfig) -> tuple[Array, float]:
    """Return (T,) heights of the lower side of the box, and its height.

    An object that shows its foot in some frames stands on the ground in all of them, also where its foot is hidden.

    Args:
        seen: The object's points, and their heights over the ground.
        config: Settings.
    """
    rule, min_share = config.ground, config.edges.min_frame_share
    low, high, ground = (np.full(len(seen.xyz_m), np.nan) for _ in range(3))
    for number, (xyz_m, height_m) in enumerate(zip(seen.xyz_m, seen.height_m, strict=True)):
        if len(xyz_m):
            low[number], high[number] = height_m.min(), height_m.max()
            ground[number] = np.median(xyz_m[:, 2] - height_m)
    known = np.flatnonzero(np.isfinite(low))
    if not len(known):
        box_height_m = seen.boxes.size_lwh_m[:, 2]
        return seen.boxes.center_m[:, 2] - box_height_m / 2, float(attained(box_height_m, min_share))
    lowest_m = -float(attained(-low, min_share))
    suspension_m = lowest_m if lowest_m >= rule.max_standing_m else 0.0
    # An object that hides the ground is itself taken for ground: the height is then too high, never too low.
    level = percentile_filter(ground[known], rule.percentile, size=rule.window_frames, mode="nearest")
    floor_m = np.interp(np.arange(len(ground)), known, level) + suspension_m
    return floor_m, float(attained(high, min_share)) - suspension_m
