"""Are the points metres? By the height of the LiDAR above the road and how far it sees, which every car bounds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from upvl_cli.config.base import Config, setting
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.perception.drive_check.finding import Finding, correction
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.sensor.origin import find_origin
from upvl_cli.types import Array, Points

# Metres in one unit of the points.
UNITS: Mapping[str, float] = {
    "metres": 1.0,
    "feet": 0.3048,
    "inches": 0.0254,
    "centimetres": 0.01,
    "millimetres": 0.001,
    "kilometres": 1000.0,
}
_NORMAL_DISTANCE = 10.0  # the median distance to which points are scaled while the road is searched
_ABOVE_ROAD = 0.4  # axes this far above the road, in that scale, can be those of the LiDAR
_MIN_POINTS = 200
_AT_ONCE = 0.1  # of a turn to each side


@dataclass(frozen=True)
class UnitsCheckConfig(Config):
    """What points in metres look like."""

    height_m: float = setting("usual height of a LiDAR above the road", "m", gt=0, le=100)
    height_spread: float = setting("standard deviation of the logarithm of that height", gt=0, le=10)
    range_m: float = setting("usual 99.9th percentile of the ranges", "m", gt=0, le=10_000)
    distance_m: float = setting("usual median distance of points from the car", "m", gt=0, le=10_000)
    range_spread: float = setting("standard deviation of the logarithm of both", gt=0, le=10)
    max_height_m: float = setting("no LiDAR stands higher above the road", "m", gt=0, le=100)
    max_range_m: float = setting("the 99.9th percentile of no LiDAR's ranges is larger", "m", gt=0, le=10_000)
    min_range_m: float = setting(
        "the 99.9th percentile of no drive's ranges is smaller", "m", gt=0, le=10_000
    )
    min_evidence: float = setting(
        "logarithm of the likelihood ratio from which another unit than metres is named", ge=0, le=1000
    )
    min_beam_contrast: float = setting(
        "how much elevations gather at the beams where the place of the LiDAR is believed", ge=1, le=100
    )
    origin_points: int = setting("points by which the place of the LiDAR is searched", ge=100, le=10**6)


@dataclass(frozen=True)
class PointScale:
    """What a drive shows of the size of a unit, each in units of its points.

    Attributes:
        height: Of the LiDAR above the road; NaN where that cannot be told.
        far: The 99.9th percentile of the ranges.
        distance: The median distance from the car.
    """

    height: float
    far: float
    distance: float


def check_units(sample: DriveSample, config: UnitsCheckConfig) -> Iterator[Finding]:
    """Yield the finding on the unit of the points.

    Args:
        sample: Part of the drive.
        config: Settings.
    """
    sweeps = [sample.sweep(run[0]) for run in sample.runs]
    # The place of the LiDAR takes a search, and is the same in all sweeps.
    middle = len(sweeps) // 2
    measured = (_measure(sweep, config, place == middle) for place, sweep in enumerate(sweeps))
    scales = [scale for scale in measured if scale is not None]
    if not scales:
        yield Finding("units", "cannot tell", "no sweep has enough points")
        return
    heights = [scale.height for scale in scales if not np.isnan(scale.height)]
    scale = PointScale(
        float(np.median(heights)) if heights else float("nan"),
        float(np.median([each.far for each in scales])),
        float(np.median([each.distance for each in scales])),
    )
    yield _judge(scale, len(scales), config)


def _judge(scale: PointScale, sweeps: int, config: UnitsCheckConfig) -> Finding:
    surprise = {unit: _surprise(scale, factor, config) for unit, factor in UNITS.items()}
    best = min(surprise, key=surprise.__getitem__)
    text = f"the farthest points at {scale.far:.4g}, half of all within {scale.distance:.3g}"
    if not np.isnan(scale.height):
        text = f"the LiDAR is {scale.height:.3g} above the road, {text}"
    evidence = f"{sweeps} sweeps"
    clear = surprise["metres"] - surprise[best] > config.min_evidence
    impossible = _is_impossible(scale, config)
    if best != "metres" and clear and not _is_impossible(_times(scale, UNITS[best]), config):
        remedy = correction(f"metres_per_unit = {UNITS[best]:g}")
        text += f": in {best} that would be usual"
        return Finding(
            "units", "fault" if impossible else "warning", text, "", evidence, f"points in {best}", remedy
        )
    if impossible:
        cause = "points in another unit, or bytes that are no coordinates"
        return Finding("units", "warning", f"{text}: no LiDAR of a car sees so", "", evidence, cause, "")
    return Finding("units", "ok", f"metres: {text}", "", evidence)


def _surprise(scale: PointScale, factor: float, config: UnitsCheckConfig) -> float:
    """Return the negative logarithm of the likelihood of what was seen, were a unit that many metres."""
    cues = [
        (scale.far, config.range_m, config.range_spread),
        (scale.distance, config.distance_m, config.range_spread),
    ]
    if not np.isnan(scale.height):
        cues.append((scale.height, config.height_m, config.height_spread))
    return sum(float(np.log(value * factor / usual) / spread) ** 2 / 2 for value, usual, spread in cues)


def _is_impossible(scale: PointScale, config: UnitsCheckConfig) -> bool:
    too_far = not config.min_range_m <= scale.far <= config.max_range_m
    return bool(scale.height > config.max_height_m or too_far)


def _times(scale: PointScale, factor: float) -> PointScale:
    return PointScale(scale.height * factor, scale.far * factor, scale.distance * factor)


def _measure(sweep: Points, config: UnitsCheckConfig, searched: bool) -> PointScale | None:
    """Return the scale that one sweep shows; None where it has too few points."""
    main = np.bincount(sweep.sensor, minlength=1).argmax()
    xyz = np.asarray(sweep.xyz_ego_m, dtype=np.float64)
    kept = (sweep.sensor == main) & np.isfinite(xyz).all(axis=1) & xyz.any(axis=1)
    xyz, offset_ns = xyz[kept], sweep.time_offset_ns[kept]
    if len(xyz) < _MIN_POINTS:
        return None
    around = np.hypot(xyz[:, 0], xyz[:, 1])
    distance = float(np.median(around))
    if distance <= 0:
        return None
    far = float(np.percentile(np.linalg.norm(xyz, axis=1), 99.9))
    # Seen at about one time, points were measured from about one place, motion compensation or not.
    at_once = np.abs(offset_ns - np.median(offset_ns)) <= _AT_ONCE * np.ptp(offset_ns)
    scaled = xyz * (_NORMAL_DISTANCE / distance)
    return PointScale(
        _height(scaled, scaled[at_once] if searched else None, config) * distance / _NORMAL_DISTANCE,
        far,
        distance,
    )


def _height(xyz: Array, at_once: Array | None, config: UnitsCheckConfig) -> float:
    """Return the height of the LiDAR above the road in the unit of points around it; NaN where it cannot be told.

    Args:
        xyz: (n, 3) points.
        at_once: (m, 3) those by which a LiDAR is searched that does not sit at the origin of the axes, or None.
        config: Settings.
    """
    road_z = road_height_m(xyz)
    if -road_z >= _ABOVE_ROAD:
        return -road_z
    if at_once is None:
        return float("nan")
    place, contrast = find_origin(at_once, np.zeros_like(at_once), road_z, config.origin_points)
    return float(place[2]) - road_z if contrast >= config.min_beam_contrast else float("nan")
