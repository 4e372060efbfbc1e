"""Whole boxes of tracked objects: one size a track, placed in each of its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import percentile_filter

from upvl_cli.geometry.se3 import apply, inverse, wrap_angle
from upvl_cli.perception.amodal.track_registration import register
from upvl_cli.perception.box_fit import rectangle_heading, to_heading_axes
from upvl_cli.types import Array, Floats

TRIM = 0.01  # share of the points left out at each end of length and width: single stray returns
FEWEST = 3  # points that have an extent
FEWEST_FRAMES = 4  # registered frames that make a model (MI-UP)
FAN_STEP_RAD = float(np.deg2rad(1.0))
EDGE_FLOOR_M = 0.05
WIDE_M = 1.2  # wider than walkers and cyclists: has wheels, and is longer than wide
LONG_M = 2.3  # longer than any bicycle: has four wheels
# The size of KITTI's mean car: what has four wheels is seldom smaller, and often seen in part.
CAR_LW_M = (3.9, 1.6)
END_M = {2.2: 2.2, np.inf: 3.0}  # up to this high nothing is wider, with its mirrors: a longer face is a side
# Of a person one side is seen. The size of KITTI's mean pedestrian; heights that people and riders have.
PERSON_LWH_M = (0.8, 0.6, 1.76)
PERSON_HEIGHT_M = (1.0, 2.2)
# Above this share of the height a vehicle's end is still wider than shoulders: who pushes a pram is not.
UPPER, SHOULDERS_M = 0.7, 0.8
GROUND_PERCENTILE, GROUND_FRAMES = 25, 11  # of the ground under it in so many frames
STAND_M = 1.5  # what is seen lower than this in some of its frames stands on the ground in all of them


@dataclass(frozen=True)
class Sightings:
    """What was seen of one object, frame by frame, in world axes.

    Attributes:
        xyz_m: T arrays (n, 3) of its points; some can be empty.
        height_m: T arrays (n,) of their heights over the ground.
        seven: (T, 7) box of each frame: place and size of what was seen.
        velocity_mps: (T, 3) smooth velocity.
        sensor_xy_m: (T, 2) where the sensor stood.
        sensor_heading_rad: (T,) where the car that carries it pointed.
    """

    xyz_m: Sequence[Floats]
    height_m: Sequence[Floats]
    seven: Floats
    velocity_mps: Floats
    sensor_xy_m: Floats
    sensor_heading_rad: Floats


def amodal(
    seen: Sightings,
    *,
    moving_mps: float,
    foot_m: float,
    min_points: int,
    radius_m: float,
    iterations: int,
    min_inlier_share: float,
    edge_share: float,
    min_aspect: float,
) -> Array:
    """(T, 7) boxes around the whole object, all of one size (MI-UP, section 4.3).

    Its points of all frames are laid on each other; the edges of what they show together are the box,
    and going back by each frame's own motion puts it there. Frames that fit nothing hold the box at the
    edge that faces the sensor: the other one is often hidden.

    Args:
        seen: The object's points and track.
        moving_mps: Slower motion gives no heading.
        foot_m: Points lower than this have no say in length and width.
        min_points: Points that a frame needs to be registered; others are too sparse.
        radius_m: Of the registration: pairs further apart are left out.
        iterations: Of the registration: most steps.
        min_inlier_share: A frame of which a smaller share finds its place is not registered.
        edge_share: An edge lies where at least this share of the frames reaches it: in fewer of them
            something else was taken along.
        min_aspect: What is wider than a cyclist is at least this many times as long as wide; of
            something seen from straight behind or before, the length is not seen.
    """
    clouds = [_body(xyz, height, foot_m) for xyz, height in zip(seen.xyz_m, seen.height_m, strict=True)]
    heading = _headings(seen, clouds, moving_mps)
    clouds, sensor = _centred(clouds, seen, heading)
    motions = register(
        clouds,
        min_points=min_points,
        radius_m=radius_m,
        iterations=iterations,
        min_inlier_share=min_inlier_share,
    )
    fitted = {at: motion for at, motion in enumerate(motions) if motion is not None}
    if len(fitted) < FEWEST_FRAMES:
        fitted = {}
    low, high = _edges(clouds)
    floor, height_m = _stood(seen, edge_share)
    is_tall = PERSON_HEIGHT_M[0] <= height_m <= PERSON_HEIGHT_M[1]
    least = np.array(PERSON_LWH_M[:2]) * is_tall * min(height_m / PERSON_LWH_M[2], 1.0)
    middle, size = _model(clouds, fitted, low, high, sensor, edge_share, min_aspect, least)
    offset = _behind(low, high, sensor, size)
    for at, motion in fitted.items():
        offset[at] = _moved(inverse(motion), middle)
    boxes = np.empty((len(heading), 7))
    boxes[:, :2] = seen.seven[:, :2] + to_heading_axes(_filled(offset), -heading)
    boxes[:, 2] = floor + height_m / 2
    boxes[:, 3:5] = size
    boxes[:, 5] = height_m
    boxes[:, 6] = wrap_angle(heading)
    return boxes


def _body(xyz_m: Floats, height_m: Floats, foot_m: float) -> Floats:
    """The points that are not on the ground; all of them where there are no others."""
    body = height_m >= foot_m
    return xyz_m[body] if body.any() else xyz_m


def _headings(seen: Sightings, clouds_m: Sequence[Floats], moving_mps: float) -> Array:
    """(T,) heading of each frame: that of motion, held through stops; the shape's where nothing moves."""
    velocity = seen.velocity_mps
    moves = np.hypot(velocity[:, 0], velocity[:, 1]) >= moving_mps
    if not moves.any():
        return np.full(len(velocity), _parked(np.concatenate(clouds_m), seen))
    heading = np.unwrap(np.arctan2(velocity[moves, 1], velocity[moves, 0]))
    return np.asarray(np.interp(np.arange(len(moves)), np.flatnonzero(moves), heading))


def _parked(xyz_m: Array, seen: Sightings) -> float:
    """Heading of what stands, from its shape; of both ways the one at an acute angle to the ego heading (UP-VL).

    A side that is longer than any vehicle is wide lies along it. A shorter face is an end when it is
    turned to the sensor: what lies behind it is hidden. Not so below a person's shoulders.
    """
    if len(xyz_m) < FEWEST:
        return float(np.median(seen.sensor_heading_rad))
    xy_m = xyz_m[:, :2]
    angle = rectangle_heading(xy_m, step_rad=FAN_STEP_RAD, floor_m=EDGE_FLOOR_M)
    turned = to_heading_axes(xy_m, angle)
    extent = _extent(turned)
    longest = extent.max()
    across = bool(extent[1] > extent[0])
    height_m = max((float(height.max()) for height in seen.height_m if len(height)), default=0.0)
    end_m = next(wide for high, wide in END_M.items() if height_m <= high)
    upper = turned[xyz_m[:, 2] >= xyz_m[:, 2].max() - (1 - UPPER) * height_m]
    is_slim = len(upper) >= FEWEST and _extent(upper).max() <= SHOULDERS_M
    if WIDE_M < longest <= end_m and not is_slim:
        sight = to_heading_axes(xy_m.mean(axis=0) - np.mean(seen.sensor_xy_m, axis=0), angle)
        across = bool(abs(sight[1]) > abs(sight[0]))
    angle += across * np.pi / 2
    away = np.cos(angle - seen.sensor_heading_rad).mean() < 0
    return float(angle + away * np.pi)


def _extent(xy_m: Array) -> Array:
    """(2,) length along each axis, without stray points."""
    return np.asarray(np.subtract(*np.quantile(xy_m, (1 - TRIM, TRIM), axis=0)))


def _stood(seen: Sightings, edge_share: float) -> tuple[Array, float]:
    """(T,) heights of the lower side of the box, and its height.

    A thing that shows its foot once stands on the ground in all frames, also where its foot is hidden.
    """
    low, high, ground = (np.full(len(seen.xyz_m), np.nan) for _ in range(3))
    for at, (xyz, height) in enumerate(zip(seen.xyz_m, seen.height_m, strict=True)):
        if len(xyz):
            low[at], high[at] = height.min(), height.max()
            ground[at] = np.median(xyz[:, 2] - height)
    known = np.flatnonzero(np.isfinite(low))
    if not len(known):
        return seen.seven[:, 2] - seen.seven[:, 5] / 2, float(_reached(seen.seven[:, 5], edge_share))
    lowest = -float(_reached(-low, edge_share))
    foot = lowest if lowest >= STAND_M else 0.0
    # Where it hides the ground, something on it is taken for that: the ground is too high then, never too low.
    level = percentile_filter(ground[known], GROUND_PERCENTILE, size=GROUND_FRAMES, mode="nearest")
    floor = np.interp(np.arange(len(ground)), known, level) + foot
    return floor, float(_reached(high, edge_share)) - foot


def _centred(clouds_m: Sequence[Floats], seen: Sightings, heading: Array) -> tuple[list[Array], Array]:
    """Points and (T, 2) sensor of each frame about the centre of its box, x along the heading."""
    turned = []
    for cloud, box, turn in zip(clouds_m, seen.seven, heading, strict=True):
        flat = to_heading_axes(cloud[:, :2] - box[:2], turn)
        turned.append(np.column_stack([flat, cloud[:, 2] - box[2]]))
    return turned, to_heading_axes(seen.sensor_xy_m - seen.seven[:, :2], heading)


def _edges(clouds_m: Sequence[Floats]) -> tuple[Array, Array]:
    """(T, 2) lowest and highest coordinate of each cloud along and across; NaN where points are too few."""
    low, high = np.full((len(clouds_m), 2), np.nan), np.full((len(clouds_m), 2), np.nan)
    for at, cloud in enumerate(clouds_m):
        if len(cloud) >= FEWEST:
            low[at], high[at] = np.quantile(cloud[:, :2], (TRIM, 1 - TRIM), axis=0)
    return low, high


def _model(
    clouds_m: Sequence[Floats],
    fitted: Mapping[int, Array],
    low: Array,
    high: Array,
    sensor: Array,
    edge_share: float,
    min_aspect: float,
    least: Array,
) -> tuple[Array, Array]:
    """(2,) middle of the whole object in the axes of its densest cloud, and (2,) its length and width."""
    if fitted:
        low, high = _edges([apply(motion, clouds_m[at]) for at, motion in fitted.items()])
        eye = np.array([_moved(motion, sensor[at]) for at, motion in fitted.items()])
        first, last = -_reached(-low, edge_share), _reached(high, edge_share)
    else:
        size = _reached(high - low, edge_share)
        first, last, eye = -size / 2, size / 2, sensor
    size = _completed(last - first, min_aspect, least)
    middle = _behind(first[None], last[None], eye.mean(axis=0)[None], size)[0]
    return middle, size


def _moved(motion: Array, xy_m: Array) -> Array:
    return apply(motion, np.array([[*xy_m, 0.0]]))[0, :2]


def _completed(size: Array, min_aspect: float, least: Array) -> Array:
    """Length and width of at least what a thing of that width or length has."""
    length, width = np.maximum(size, least)
    if width > WIDE_M or length > LONG_M:
        length, width = np.maximum((length, width), CAR_LW_M)
        length = max(length, min_aspect * width)
    return np.array([length, width])


def _reached(values: Array, share: float) -> Array:
    """The largest value that this share of the frames reaches, and at least two of them."""
    values = values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))]
    if not len(values):
        return np.zeros(values.shape[1:])
    rank = min(len(values), max(2, int(np.ceil(share * len(values)))))
    return np.asarray(np.sort(values, axis=0)[-rank])


def _behind(low: Array, high: Array, sensor: Array, size: Array) -> Array:
    """(T, 2) centre of a box of that size: what was not seen of it lies behind the edge that faces the sensor.

    A vehicle shows a corner, so that this holds along and across. A small thing shows one side, wholly:
    its rest is behind that, along the line of sight.
    """
    seen = (low + high) / 2
    sight = seen - sensor
    away = np.sign(sight)
    if size.max() <= WIDE_M:
        away = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    return np.asarray(seen + away * (size - (high - low)) / 2)


def _filled(offset: Array) -> Array:
    """The offsets with those of frames that show nothing between those of their neighbours."""
    known = np.isfinite(offset).all(axis=1)
    if not known.any():
        return np.zeros_like(offset)
    at = np.arange(len(offset))
    return np.stack([np.interp(at, at[known], column[known]) for column in offset.T], axis=1)
