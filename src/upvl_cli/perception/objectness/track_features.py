"""Features of a track: the median shape in its best-seen frames, its size and its motion."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.box_fit import to_heading_axes
from upvl_cli.perception.objectness.config import ObjectnessConfig
from upvl_cli.perception.objectness.shape import MIN_POINTS, SHAPE_FEATURES, frame_shape
from upvl_cli.types import Array, Boxes, Ints

TRACK_FEATURES = ("length_m", "width_m", "height_m", "seconds", "seen_share", "speed_mps", "reach_m")
FEATURES = (*SHAPE_FEATURES, *TRACK_FEATURES)


def track_features(seen: Sightings, boxes: Boxes, ring_points: Ints, config: ObjectnessConfig) -> Array:
    """Return (f,) `FEATURES` of a track; NaN for those of its shape where no frame has enough points.

    Args:
        seen: What was seen of the track.
        boxes: T boxes that were fitted to it, all of one size, in world axes.
        ring_points: (T,) other points around it in each frame.
        config: Settings.
    """
    num_points = np.array([len(cloud) for cloud in seen.xyz_m])
    # The denser half of its frames; ties in order of time.
    best = np.argsort(-num_points, kind="stable")[: min(config.max_frames, -(-len(num_points) // 2))]
    shapes = [
        _shape_in(seen, boxes, number, int(ring_points[number]), config)
        for number in np.sort(best).tolist()
        if num_points[number] >= MIN_POINTS
    ]
    shape = np.median(shapes, axis=0) if shapes else np.full(len(SHAPE_FEATURES), np.nan)
    center_m = boxes.center_m[:, :2]
    speed_mps = np.hypot(seen.velocity_mps[:, 0], seen.velocity_mps[:, 1])
    motion = [
        seen.time_s[-1] - seen.time_s[0],
        np.mean(num_points > 0),
        np.percentile(speed_mps, 80),
        np.linalg.norm(center_m - center_m[0], axis=1).max(),
    ]
    return np.concatenate([shape, boxes.size_lwh_m[0], motion])


def _shape_in(
    seen: Sightings, boxes: Boxes, number: int, ring_points: int, config: ObjectnessConfig
) -> Array:
    """Return the shape of a track in one frame."""
    center_m, heading_rad = boxes.center_m[number], float(boxes.heading_rad[number])
    xyz_m = seen.xyz_m[number] - center_m
    turned = np.column_stack([to_heading_axes(xyz_m[:, :2], heading_rad), xyz_m[:, 2]])
    size_lwh_m = boxes.size_lwh_m[number]
    return frame_shape(turned, seen.height_m[number], size_lwh_m, ring_points, config)
