"""The sensor card of a drive, measured from a sample of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.camera import project
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.perception.sensor.beams import beams_by_histogram, beams_by_order
from upvl_cli.perception.sensor.card import CameraCard, LidarCard, SensorCard
from upvl_cli.perception.sensor.config import SensorConfig
from upvl_cli.perception.sensor.coverage import find_car, hidden_sectors, scene_changes
from upvl_cli.perception.sensor.intensity import measure_intensity
from upvl_cli.perception.sensor.origin import beam_contrast, elevations_deg, find_origin
from upvl_cli.perception.sensor.turn import (
    Sense,
    azimuths_deg,
    column_step_deg,
    field_of_view_deg,
    sense_of_turn,
)
from upvl_cli.types import Array, Camera, Floats, Points

_GAP = 1.5  # a step of more than this many usual ones is a gap
_FINE_BIN_DEG = 0.05
_ABOVE_ROAD_M = 0.4  # ego axes this far above the road can be those of the LiDAR
_SAME_CONTRAST = 0.9
_POINT_STEP = 20  # of the points whose share a camera sees


@dataclass(frozen=True)
class _LidarSweep:
    """The points of one LiDAR in one sweep, without those that are no numbers.

    Attributes:
        xyz_m: (n, 3) points in ego axes.
        shift_m: (n, 3) how far the car had moved when each was measured.
        points: The n points.
    """

    xyz_m: Floats
    shift_m: Floats
    points: Points


def measure_sensor(sample: DriveSample, config: SensorConfig) -> SensorCard:
    """Return what the sweeps and pictures of a drive show of its sensors.

    Args:
        sample: Part of the drive.
        config: Settings.
    """
    steps = sample.steps
    road_z_m = measured_road_z_m(sample)
    seconds = np.diff([frame.time_ns for frame in sample.frames]) * 1e-9
    regular = seconds[(seconds > 0) & (seconds < _GAP * np.median(seconds))] if len(seconds) else seconds
    spread = [sample.sweep(run[0]) for run in sample.runs]
    clouds = [sweep.xyz_ego_m[np.isfinite(sweep.xyz_ego_m).all(axis=1)] for sweep in spread]
    spans = [np.ptp(sweep.time_offset_ns) * 1e-9 for sweep in spread if len(sweep)]
    turn_s = float(np.median(spans)) if spans else 0.0
    numbers = np.unique(np.concatenate([np.zeros(0, np.uint8), *(sweep.sensor for sweep in spread)]))
    return SensorCard(
        frames=len(sample.frames),
        rate_hz=1 / float(regular.mean()) if len(regular) else None,
        jitter=float(regular.std() / regular.mean()) if len(regular) else 0.0,
        turn_s=turn_s if turn_s > 0 else None,
        road_z_m=road_z_m,
        car=find_car(clouds, road_z_m, config) if clouds else None,
        car_drives=bool(clouds) and scene_changes(clouds, road_z_m),
        lidars=tuple(_lidar(sample, int(number), road_z_m, config) for number in numbers),
        cameras=tuple(_camera(sample, camera, steps) for camera in sample.cameras),
    )


def measured_road_z_m(sample: DriveSample) -> float:
    """Return the height of the road in ego axes by a sweep of each run; as the drive says where none has a point."""
    heights = []
    for run in sample.runs:
        xyz_m = sample.sweep(run[0]).xyz_ego_m
        if len(xyz_m):
            heights.append(road_height_m(xyz_m))
    return float(np.median(heights)) if heights else sample.ground_z_m


def _lidar(sample: DriveSample, number: int, road_z_m: float, config: SensorConfig) -> LidarCard:
    """Return the card of one LiDAR."""
    runs = sample.runs[:: max(1, len(sample.runs) // config.beam_sweeps)][: config.beam_sweeps]
    sweeps = [_sweep(sample, run[0], number) for run in runs]
    counts = [int((sample.sweep(step).sensor == number).sum()) for step in sample.steps]
    origin_m, contrast = _origin(max(sweeps, key=lambda sweep: len(sweep.xyz_m)), road_z_m, config)
    beams_deg: Floats = np.zeros(0)
    step_deg = float("nan")
    if contrast >= config.min_beam_contrast:
        beams_deg, step_deg = _beams(sweeps, origin_m, config)
    known = len(beams_deg) > 0
    place_m = origin_m if known else np.zeros(3)
    height_m = float(place_m[2]) - road_z_m
    azimuth = np.concatenate([azimuths_deg(sweep.xyz_m, place_m) for sweep in sweeps])
    range_m = np.concatenate([np.linalg.norm(sweep.xyz_m - place_m, axis=1) for sweep in sweeps])
    elevation = np.concatenate([elevations_deg(sweep.xyz_m, place_m) for sweep in sweeps])
    far = range_m > config.near_m
    view = field_of_view_deg(azimuth[far])
    low, high = np.percentile(elevation[far], [0.1, 99.9]) if far.any() else (0.0, 0.0)
    return LidarCard(
        sensor=number,
        points=(min(counts), int(np.median(counts)), max(counts)),
        beams_deg=tuple(float(beam) for beam in beams_deg),
        elevation_deg=(float(low), float(high)),
        azimuth_step_deg=None if np.isnan(step_deg) else step_deg,
        field_of_view_deg=view[0],
        direction_deg=view[1],
        sense=_sense(sweeps, place_m),
        origin_m=(float(place_m[0]), float(place_m[1]), float(place_m[2])) if known else None,
        height_m=height_m if known or height_m >= _ABOVE_ROAD_M else None,
        range_m=(float(np.percentile(range_m, 99.9)), float(range_m.max())) if len(range_m) else (0.0, 0.0),
        hidden_deg=hidden_sectors(azimuth, range_m, view, config),
        intensity=measure_intensity(sweep.points.intensity for sweep in sweeps),
    )


def _sweep(sample: DriveSample, step: int, number: int) -> _LidarSweep:
    points = sample.sweep(step)
    points = points[(points.sensor == number) & np.isfinite(points.xyz_ego_m).all(axis=1)]
    velocity_mps = np.zeros(3)
    if sample.world_from_ego is not None and len(sample.frames) > 1:
        first = min(step, len(sample.frames) - 2)
        motion = compose(inverse(sample.world_from_ego[first]), sample.world_from_ego[first + 1])
        velocity_mps = motion[:3, 3] / sample.seconds(first, first + 1)
    shift_m = points.time_offset_ns[:, None] * 1e-9 * velocity_mps
    return _LidarSweep(points.xyz_ego_m.astype(np.float64), shift_m, points)


def _origin(sweep: _LidarSweep, road_z_m: float, config: SensorConfig) -> tuple[Floats, float]:
    """Return the place of the LiDAR and the contrast of its beams there: the origin of the axes where that will do."""
    found, contrast = find_origin(sweep.xyz_m, sweep.shift_m, road_z_m, config.origin_points)
    if -road_z_m >= _ABOVE_ROAD_M:
        far = sweep.xyz_m[np.hypot(sweep.xyz_m[:, 0], sweep.xyz_m[:, 1]) > config.near_m]
        at_axes = beam_contrast(elevations_deg(far, np.zeros(3)), _FINE_BIN_DEG)
        if at_axes >= _SAME_CONTRAST * contrast:
            return np.zeros(3), at_axes
    return found, contrast


def _beams(sweeps: Sequence[_LidarSweep], place_m: Floats, config: SensorConfig) -> tuple[Floats, float]:
    """Return the elevations of the beams and the step between columns; none and NaN where they cannot be told."""
    ordered, elevations, azimuths = [], [], []
    for sweep in sweeps:
        place = place_m + sweep.shift_m
        far = np.linalg.norm(sweep.xyz_m - place, axis=1) > config.near_m
        elevations.append(elevations_deg(sweep.xyz_m, place)[far])
        azimuths.append(azimuths_deg(sweep.xyz_m, place)[far])
        ordered.append(beams_by_order(azimuths[-1], elevations[-1]))
    known = [beams for beams in ordered if beams is not None]
    beams_deg: Floats | None = None
    if len(known) == len(sweeps) and len({len(beams) for beams in known}) == 1:
        beams_deg = np.median(known, axis=0)
    if beams_deg is None:
        beams_deg = beams_by_histogram(np.concatenate(elevations))
    if beams_deg is None:
        return np.zeros(0), float("nan")
    return beams_deg, column_step_deg(azimuths[0], elevations[0], beams_deg)


def _sense(sweeps: Sequence[_LidarSweep], place_m: Array) -> Sense:
    """Return the sense of the turn by the times of the points, else by their order in the file."""
    for sweep in sweeps:
        azimuth = azimuths_deg(sweep.xyz_m, place_m)
        times = sweep.points.time_offset_ns
        return sense_of_turn(azimuth, times if np.ptp(times) > 0 else np.arange(len(times)))
    return "unknown"


def _camera(sample: DriveSample, camera: Camera, steps: Sequence[int]) -> CameraCard:
    """Return the card of one camera."""
    first = sample.sweep(steps[0]).xyz_ego_m[::_POINT_STEP]
    first = first[np.isfinite(first).all(axis=1)]
    seen = project(camera, first)[2] if len(first) else np.zeros(0, bool)
    view = camera.ego_from_camera[:3, 2]
    edges = (np.array([-0.5, camera.width_px - 0.5]) - camera.intrinsic[0, 2]) / camera.intrinsic[0, 0]
    picture = sample.picture(steps[0], camera.name)
    return CameraCard(
        name=camera.name,
        size_px=(camera.width_px, camera.height_px),
        field_of_view_deg=float(np.degrees(np.diff(np.arctan(edges))[0])),
        direction_deg=float(np.degrees(np.arctan2(view[1], view[0]))),
        points_share=float(seen.mean()) if len(seen) else 0.0,
        delay_s=None if picture is None else (picture.time_ns - sample.frames[steps[0]].time_ns) * 1e-9,
    )
