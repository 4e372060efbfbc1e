"""How high an object is, and where it stands."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.amodal.config import AmodalFitConfig, AmodalGroundConfig
from upvl_cli.perception.amodal.edges import attained
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.types import Array, Floats


def vertical_extent(seen: Sightings, config: AmodalFitConfig, *, moves: bool) -> tuple[Array, float]:
    """Return (T,) heights of the lower side of the box, and its height.

    An object that shows its foot in some frames stands on the ground in all of them, also where its foot is hidden.

    Args:
        seen: The object's points, and their heights over the ground.
        config: Settings.
        moves: Whether the object moves; what stands has one height.
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
    if moves:
        level = ground_level(seen.time_s[known], ground[known], rule)
    else:
        level = np.full(len(known), np.percentile(ground[known], rule.percentile))
    floor_m = np.interp(seen.time_s, seen.time_s[known], level) + suspension_m
    return floor_m, float(attained(high, min_share)) - suspension_m


def ground_level(time_s: Floats, ground_m: Floats, config: AmodalGroundConfig) -> Array:
    """Return (T,) ground heights below an object, each a low percentile of those around it in time.

    An object that hides the ground is itself taken for ground: a height is then too high, never too low. What all
    heights of a window have in common, a slope that the object drives up or a world that estimated poses tilt, is
    taken out before as a line (Theil and Sen: the median slope of all pairs) and put back.

    Args:
        time_s: (T,) ascending times.
        ground_m: (T,) ground height at each.
        config: Percentile, and the window.
    """
    level = np.empty(len(time_s))
    for number, time in enumerate(time_s):
        nearest = np.argsort(np.abs(time_s - time), kind="stable")
        inside = int((np.abs(time_s - time) <= config.window_s / 2).sum())
        window = np.sort(nearest[: max(inside, config.min_window_frames)])
        later, earlier = np.tril_indices(len(window), -1)
        run_s = time_s[window][later] - time_s[window][earlier]
        rise_m = ground_m[window][later] - ground_m[window][earlier]
        slope_mps = np.median(rise_m[run_s > 0] / run_s[run_s > 0]) if (run_s > 0).any() else 0.0
        leveled_m = ground_m[window] - slope_mps * (time_s[window] - time)
        level[number] = np.percentile(leveled_m, config.percentile)
    return level
