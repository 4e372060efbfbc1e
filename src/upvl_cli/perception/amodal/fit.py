"""Fit of amodal boxes to tracked objects: one size a track, and its position in each frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.se3 import apply, inverse, wrap_angle
from upvl_cli.perception.amodal.completion import complete_center, complete_size, person_size
from upvl_cli.perception.amodal.config import AmodalFitConfig, EdgeConfig
from upvl_cli.perception.amodal.edges import attained, trimmed_edges
from upvl_cli.perception.amodal.heading import headings
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.amodal.track_registration import register_track
from upvl_cli.perception.amodal.vertical import vertical_extent
from upvl_cli.perception.box_fit import to_heading_axes
from upvl_cli.types import Array, Boxes, Floats


@dataclass(frozen=True)
class KnownShape:
    """What is known of a track from elsewhere, where only a part of it is fitted.

    Attributes:
        size_lwh_m: (3,) its size.
        heading_rad: (T,) its heading in the frames of the part.
    """

    size_lwh_m: Floats
    heading_rad: Floats


def fit_amodal_boxes(seen: Sightings, config: AmodalFitConfig, known: KnownShape | None = None) -> Boxes:
    """Return T boxes around the whole object, all of one size (MI-UP, section 4.3).

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
    heading_rad = headings(seen, clouds, config) if known is None else known.heading_rad
    clouds, sensor_xy_m = _to_box_axes(clouds, seen, heading_rad)
    motions = register_track(clouds, config.registration)
    low, high = trimmed_edges(clouds, config.edges.trim_share)
    floor_m, height_m = vertical_extent(seen, config)
    min_size_m = person_size(height_m, config.size)
    if motions:
        first, last, sensor_m = _registered_edges(clouds, motions, sensor_xy_m, config.edges)
    else:
        extent_m = attained(high - low, config.edges.min_frame_share)
        first, last, sensor_m = -extent_m / 2, extent_m / 2, sensor_xy_m.mean(axis=0)
    size_m = complete_size(last - first, min_size_m, config.size)
    if known is not None:
        size_m, height_m = known.size_lwh_m[:2], float(known.size_lwh_m[2])
    middle = complete_center(first[None], last[None], sensor_m[None], size_m, config.size)[0]
    offset = complete_center(low, high, sensor_xy_m, size_m, config.size)
    for number, motion in motions.items():
        offset[number] = _move(inverse(motion), middle)
    xy_m = seen.boxes.center_m[:, :2] + to_heading_axes(_interpolate_missing(offset), -heading_rad)
    return Boxes(
        np.column_stack([xy_m, floor_m + height_m / 2]),
        np.tile([*size_m, height_m], (len(xy_m), 1)),
        wrap_angle(heading_rad),
    )


def _above_clearance(xyz_m: Floats, height_m: Floats, ground_clearance_m: float) -> Floats:
    """Return the points that are not on the ground; all of them where there are no others."""
    is_body = height_m >= ground_clearance_m
    return xyz_m[is_body] if is_body.any() else xyz_m


def _to_box_axes(
    clouds_m: Sequence[Floats], seen: Sightings, heading_rad: Array
) -> tuple[list[Array], Array]:
    """Return points and (T, 2) sensor of each frame about the center of its box, x along the heading."""
    center_m, turned = seen.boxes.center_m, []
    for cloud, center, angle in zip(clouds_m, center_m, heading_rad, strict=True):
        flat = to_heading_axes(cloud[:, :2] - center[:2], angle)
        turned.append(np.column_stack([flat, cloud[:, 2] - center[2]]))
    return turned, to_heading_axes(seen.sensor_xy_m - center_m[:, :2], heading_rad)


def _registered_edges(
    clouds_m: Sequence[Floats], motions: Mapping[int, Array], sensor_xy_m: Array, config: EdgeConfig
) -> tuple[Array, Array, Array]:
    """Return (2,) lowest and highest edge and mean sensor position in the axes of the densest cloud."""
    moved = [apply(motion, clouds_m[number]) for number, motion in motions.items()]
    low, high = trimmed_edges(moved, config.trim_share)
    sensors = np.array([_move(motion, sensor_xy_m[number]) for number, motion in motions.items()])
    first, last = -attained(-low, config.min_frame_share), attained(high, config.min_frame_share)
    return first, last, sensors.mean(axis=0)


def _move(motion: Array, xy_m: Array) -> Array:
    return apply(motion, np.array([[*xy_m, 0.0]]))[0, :2]


def _interpolate_missing(offset: Array) -> Array:
    """Return the offsets, where NaN interpolated in time between those of the frames around; zeros without any."""
    is_known = np.isfinite(offset).all(axis=1)
    if not is_known.any():
        return np.zeros_like(offset)
    frame = np.arange(len(offset))
    return np.stack([np.interp(frame, frame[is_known], column[is_known]) for column in offset.T], axis=1)
