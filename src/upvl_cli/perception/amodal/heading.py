"""Heading of a tracked object, from its motion or its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.perception.amodal.config import AmodalFitConfig, HeadingConfig
from upvl_cli.perception.amodal.edges import MIN_EXTENT_POINTS, trimmed_extent
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.box_fit import rectangle_heading, to_heading_axes
from upvl_cli.types import Array, Boxes, Floats

STEP_RAD = float(np.deg2rad(1.0))  # of the search for a heading: finer than points of range noise can tell
EDGE_FLOOR_M = 0.05  # distances to an edge below range noise all count the same


def headings(seen: Sightings, clouds_m: Sequence[Floats], config: AmodalFitConfig) -> tuple[Array, bool]:
    """Return (T,) headings, and whether they are those of a motion, held through stops; else that of the shape.

    Args:
        seen: The object's track.
        clouds_m: T clouds (n, 3) of it, in world axes.
        config: Settings.
    """
    heading_rad = moving_headings(seen.boxes, seen.velocity_mps, config.heading)
    if heading_rad is None:
        return np.full(len(clouds_m), parked_heading(np.concatenate(clouds_m), seen, config)), False
    return heading_rad, True


def moving_headings(boxes: Boxes, velocity_mps: Floats, config: HeadingConfig) -> Array | None:
    """Return (T,) directions of motion, held through stops; None for what stands.

    One noisy frame gives what is parked a speed. What drives or walks moves in a share of its frames, gets
    somewhere for its length, and does so without much to and fro.

    Args:
        boxes: T boxes in world axes.
        velocity_mps: (T, 2 or more) smooth velocity.
        config: Settings.
    """
    moves = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]) >= config.min_speed_mps
    if not moves.any() or moves.mean() < config.min_moving_share:
        return None
    steps_m = np.diff(boxes.center_m[:, :2], axis=0)
    reach_m = float(np.linalg.norm(boxes.center_m[:, :2] - boxes.center_m[0, :2], axis=1).max())
    asked_m = min(
        config.min_reach_m, config.min_reach_lengths * float(np.median(boxes.size_lwh_m[:, :2].max(axis=1)))
    )
    if reach_m < max(asked_m, config.min_reach_share * float(np.linalg.norm(steps_m, axis=1).sum())):
        return None
    heading_rad = np.unwrap(np.arctan2(velocity_mps[moves, 1], velocity_mps[moves, 0]))
    return np.asarray(np.interp(np.arange(len(moves)), np.flatnonzero(moves), heading_rad))


def parked_heading(xyz_m: Array, seen: Sightings, config: AmodalFitConfig) -> float:
    """Return the heading of an object that stands, from its shape.

    A side that is longer than any vehicle is wide lies along the heading. A shorter face is an end when it is
    turned to the sensor: what lies behind it is hidden; not so for a person, who is slim above. Of both ways
    along that axis the one at an acute angle to the ego heading is taken (UP-VL).

    Args:
        xyz_m: (n, 3) points of all frames, in world axes.
        seen: The object's track.
        config: Settings.
    """
    if len(xyz_m) < MIN_EXTENT_POINTS:
        return float(np.median(seen.sensor_heading_rad))
    xy_m = xyz_m[:, :2]
    angle_rad = rectangle_heading(xy_m, step_rad=STEP_RAD, floor_m=EDGE_FLOOR_M)
    turned = to_heading_axes(xy_m, angle_rad)
    extent_m = trimmed_extent(turned, config.edges.trim_share)
    is_across = bool(extent_m[1] > extent_m[0])
    if _is_vehicle_end(turned, xyz_m[:, 2], float(extent_m.max()), seen, config):
        sight = to_heading_axes(xy_m.mean(axis=0) - np.mean(seen.sensor_xy_m, axis=0), angle_rad)
        is_across = bool(abs(sight[1]) > abs(sight[0]))
    angle_rad += is_across * np.pi / 2
    is_opposite = np.cos(angle_rad - seen.sensor_heading_rad).mean() < 0
    return float(angle_rad + is_opposite * np.pi)


def _is_vehicle_end(
    turned_m: Array, z_m: Array, longest_m: float, seen: Sightings, config: AmodalFitConfig
) -> bool:
    """Return whether the longest face is as wide as the end of a vehicle, at its top too."""
    rule = config.heading
    height_m = max((float(height.max()) for height in seen.height_m if len(height)), default=0.0)
    is_low = height_m <= rule.low_vehicle_height_m
    upper = turned_m[z_m >= z_m.max() - (1 - rule.upper_share) * height_m]
    is_slim = (
        len(upper) >= MIN_EXTENT_POINTS
        and trimmed_extent(upper, config.edges.trim_share).max() <= rule.shoulder_width_m
    )
    max_width_m = rule.max_low_width_m if is_low else rule.max_high_width_m
    return rule.min_wheeled_width_m < longest_m <= max_width_m and not is_slim
