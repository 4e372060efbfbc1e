"""Fit of amodal boxes to tracked objects: one size a track, and its position in each frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.se3 import apply, inverse, wrap_angle
from upvl_cli.perception.amodal.completion import anchor, complete_center, shown_sides
from upvl_cli.perception.amodal.config import AmodalFitConfig, EdgeConfig, SizePriorConfig
from upvl_cli.perception.amodal.edges import MIN_EXTENT_POINTS, attained, trimmed_edges
from upvl_cli.perception.amodal.heading import headings
from upvl_cli.perception.amodal.residual import cloud_residual_m
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.amodal.size_prior import whole_size
from upvl_cli.perception.amodal.track_registration import register_track
from upvl_cli.perception.amodal.vertical import vertical_extent
from upvl_cli.perception.box_fit import to_heading_axes
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints


@dataclass(frozen=True)
class KnownShape:
    """What is known of a track from elsewhere, where only a part of it is fitted.

    Attributes:
        size_lwh_m: (3,) its size.
        heading_rad: (T,) its heading in the frames of the part.
        moves: Whether it moves at some time.
    """

    size_lwh_m: Floats
    heading_rad: Floats
    moves: bool


@dataclass(frozen=True)
class AmodalFit:
    """The boxes of a track, and what they rest on.

    Attributes:
        boxes: T boxes, all of one size.
        sides_seen: How many of the four sides faced the sensor.
        residual_m: By how much the registered clouds differ; -1 where fewer than two are registered.
    """

    boxes: Boxes
    sides_seen: int
    residual_m: float


def fit_amodal_boxes(seen: Sightings, config: AmodalFitConfig, known: KnownShape | None = None) -> AmodalFit:
    """Fit T boxes around the whole object, all of one size (MI-UP, section 4.3).

    The clouds of all frames are registered with each other; the edges of their union are the box, and the inverse
    of each frame's motion puts it there. In a frame that is not registered the box is placed at the edge that faces
    the sensor: the opposite one is often hidden.

    Args:
        seen: The object's points and track.
        config: Settings.
        known: Size and headings, where they are not to be found from these frames.
    """
    clouds = [
        _above_clearance(xyz_m, height_m, config.ground.ground_clearance_m)
        for xyz_m, height_m in zip(seen.xyz_m, seen.height_m, strict=True)
    ]
    heading_rad, moves = headings(seen, clouds, config) if known is None else (known.heading_rad, known.moves)
    place_m = seen.boxes.center_m if moves else _one_place(seen.boxes)
    clouds, sensor_xy_m = _to_box_axes(clouds, place_m, seen.sensor_xy_m, heading_rad)
    motions = register_track(clouds, config.registration) if moves else _at_rest(clouds)
    low, high = trimmed_edges(clouds, config.edges.trim_share)
    floor_m, height_m = vertical_extent(seen, config, moves=moves)
    if motions:
        first, last, sensors_m = _registered_edges(clouds, motions, sensor_xy_m, config.edges)
    else:
        extent_m = attained(high - low, config.edges.min_frame_share)
        first, last, sensors_m = -extent_m / 2, extent_m / 2, sensor_xy_m
    num_points = np.array([len(clouds[number]) for number in (motions or range(len(clouds)))])
    shown = shown_sides(last - first, sensors_m - (first + last) / 2, num_points, config.size)
    speed_mps = float(np.hypot(*seen.velocity_mps[:, :2].T).max()) if moves else 0.0
    size_lwh_m = (
        _whole_size(np.append(last - first, height_m), shown, num_points, speed_mps, config.size)
        if known is None
        else known.size_lwh_m
    )
    size_m, height_m = size_lwh_m[:2], float(size_lwh_m[2])
    is_vehicle = bool(size_m[1] > config.heading.min_wheeled_width_m)
    middle = complete_center(
        first[None], last[None], sensors_m.mean(axis=0)[None], size_m, is_vehicle=is_vehicle
    )[0]
    offset = complete_center(low, high, sensor_xy_m, size_m, is_vehicle=is_vehicle)
    registered = np.full_like(offset, np.nan)
    for number, motion in motions.items():
        registered[number] = _move(inverse(motion), middle)
    facing = is_vehicle & (np.abs(sensor_xy_m - offset) > size_m / 2)
    # A farther face is that of a part: something else hides the rest.
    facing &= np.abs(offset - registered) <= config.edges.max_anchor_m
    window_s = config.edges.anchor_window_s if moves else np.inf
    offset = anchor(registered, np.where(facing, offset, np.nan), seen.time_s, window_s, fallback=offset)
    xy_m = place_m[:, :2] + to_heading_axes(_interpolate_missing(offset), -heading_rad)
    boxes = Boxes(
        np.column_stack([xy_m, floor_m + height_m / 2]),
        np.tile([*size_m, height_m], (len(xy_m), 1)),
        wrap_angle(heading_rad),
    )
    return AmodalFit(boxes, int(shown.sum()), cloud_residual_m(clouds, motions))


def _whole_size(
    seen_m: Floats, shown: Bools, num_points: Ints, speed_mps: float, config: SizePriorConfig
) -> Array:
    """Return (3,) length, width and height of the whole object.

    Args:
        seen_m: (3,) length, width and height that were seen.
        shown: (4,) whether front, rear, left and right were turned to the sensor.
        num_points: (T,) points of each frame.
        speed_mps: The highest speed of the object; 0 for what stands.
        config: What is known of sizes.
    """
    is_tall = num_points.max(initial=0) >= config.min_height_points
    is_shown = np.array([shown[2:].any(), shown[:2].any(), is_tall])
    return whole_size(seen_m, is_shown, speed_mps, config)


def _above_clearance(xyz_m: Floats, height_m: Floats, ground_clearance_m: float) -> Floats:
    """Return the points that are not on the ground; all of them where there are no others."""
    is_body = height_m >= ground_clearance_m
    return xyz_m[is_body] if is_body.any() else xyz_m


def _one_place(boxes: Boxes) -> Array:
    """Return (T, 3) the median center of the boxes of an object that stands, for each of them."""
    return np.tile(np.median(boxes.center_m, axis=0), (len(boxes), 1))


def _at_rest(clouds_m: Sequence[Floats]) -> dict[int, Array]:
    """Return no motion for each cloud with an extent: those of an object that stands lie as they should."""
    return {number: np.eye(4) for number, cloud in enumerate(clouds_m) if len(cloud) >= MIN_EXTENT_POINTS}


def _to_box_axes(
    clouds_m: Sequence[Floats], center_m: Array, sensor_xy_m: Array, heading_rad: Array
) -> tuple[list[Array], Array]:
    """Return points and (T, 2) sensor of each frame about a center of its own, x along the heading."""
    turned = []
    for cloud, center, angle in zip(clouds_m, center_m, heading_rad, strict=True):
        flat = to_heading_axes(cloud[:, :2] - center[:2], angle)
        turned.append(np.column_stack([flat, cloud[:, 2] - center[2]]))
    return turned, to_heading_axes(sensor_xy_m - center_m[:, :2], heading_rad)


def _registered_edges(
    clouds_m: Sequence[Floats], motions: Mapping[int, Array], sensor_xy_m: Array, config: EdgeConfig
) -> tuple[Array, Array, Array]:
    """Return (2,) lowest and highest edge and (k, 2) sensor positions in the axes of the densest cloud."""
    moved = [apply(motion, clouds_m[number]) for number, motion in motions.items()]
    low, high = trimmed_edges(moved, config.trim_share)
    sensors = np.array([_move(motion, sensor_xy_m[number]) for number, motion in motions.items()])
    first, last = -attained(-low, config.min_frame_share), attained(high, config.min_frame_share)
    return first, last, sensors


def _move(motion: Array, xy_m: Array) -> Array:
    return apply(motion, np.array([[*xy_m, 0.0]]))[0, :2]


def _interpolate_missing(offset: Array) -> Array:
    """Return the offsets, where NaN interpolated in time between those of the frames around; zeros without any."""
    is_known = np.isfinite(offset).all(axis=1)
    if not is_known.any():
        return np.zeros_like(offset)
    frame = np.arange(len(offset))
    return np.stack([np.interp(frame, frame[is_known], column[is_known]) for column in offset.T], axis=1)
