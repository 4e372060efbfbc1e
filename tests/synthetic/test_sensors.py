"""The sensor presets: each measures as its numbers say, and the truth keeps to its rate."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from upvl_cli.geometry.se3 import apply
from upvl_cli.synthetic.cast import Caster
from upvl_cli.synthetic.config import SENSOR_EFFECTS, CityConfig, SensorName
from upvl_cli.synthetic.dataset import City
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.labels import CityLabels
from upvl_cli.synthetic.lidar import rays_at
from upvl_cli.synthetic.lidar import sweep as measured
from upvl_cli.synthetic.sensors import SENSORS
from upvl_cli.types import Array, Floats, Points

SHIPPED = CityConfig(**tomllib.loads((Path(__file__).parents[2] / "stages" / "synthetic.toml").read_text()))
# Beams of all LiDARs, lowest and highest elevation of the main one in degrees, its columns, sweeps a second, reach.
STATED: dict[SensorName, tuple[int, float, float, int, int, float]] = {
    "waymo": (64 + 4 * 21, -17.6, 2.4, 2500, 10, 80.0),
    "kitti": (64, -24.33, 2.0, 2083, 10, 120.0),
    "twin32": (64, -25.0, 15.0, 1800, 10, 200.0),
    "hdl32_20hz": (32, -30.67, 10.67, 1084, 20, 100.0),
    "hdl32_2hz": (32, -30.67, 10.67, 1084, 2, 100.0),
    "beams40": (40, -25.0, 15.0, 1800, 10, 200.0),
    "beams16": (16, -15.0, 15.0, 1800, 10, 100.0),
    "lyft_5hz": (64, -25.0, 3.0, 1250, 5, 200.0),
    "solid_state": (126, -12.5, 12.5, 600, 10, 200.0),
}
CAR_LENGTH_M, CAR_WIDTH_M, AXLE_TO_REAR_M = 4.2, 1.7, 0.8
every_preset = pytest.mark.parametrize("name", STATED)


@cache
def city(name: SensorName) -> City:
    return City(replace(SHIPPED, sensor=name, frames=2, noise=0.0, density=0.4))


@cache
def sweep(name: SensorName) -> tuple[CityDrive, Points]:
    drive = city(name).open("train-000")
    return drive, drive.points(0)


@cache
def caster(name: SensorName) -> Caster:
    return Caster(sweep(name)[0].scene)


def from_mount(name: SensorName, lidar: int) -> tuple[Floats, Floats, Array]:
    """Elevations and azimuths in degrees, and ranges, of what one LiDAR measures, as its own mount saw it."""
    drive, points = sweep(name)
    mine = points.sensor == lidar
    moment = drive.scene.ego.at(points.time_offset_ns[mine] / 1e9)
    world = apply(drive.world_from_ego[0], points.xyz_ego_m[mine])
    away = moment.local(world) - np.array(drive.sensors.lidars[lidar].mount_m)
    far = np.linalg.norm(away, axis=1)
    return np.rad2deg(np.arcsin(away[:, 2] / far)), np.rad2deg(np.arctan2(away[:, 1], away[:, 0])), far


def test_there_is_a_preset_of_every_name() -> None:
    assert set(get_args(SensorName)) == set(SENSORS) == set(SENSOR_EFFECTS) == set(STATED)
    assert SHIPPED.sensor == "waymo" and SHIPPED.clutter == 0


@every_preset
def test_beams_columns_rate_and_reach_are_as_stated(name: SensorName) -> None:
    beams, low, high, columns, rate, reach = STATED[name]
    drive, _ = sweep(name)
    main = drive.sensors.lidars[0]
    degrees = np.rad2deg(main.elevation_rad)
    assert sum(len(lidar.elevation_rad) for lidar in drive.sensors.lidars) == beams
    assert (degrees.min(), degrees.max()) == pytest.approx((low, high), abs=0.01)
    assert len(np.unique(degrees.round(6))) == len(degrees)
    assert (len(main.azimuth_rad), main.reach_m) == (columns, reach)
    times = [frame.time_ns for frame in drive.frames]
    assert (drive.rate_hz, times[1] - times[0]) == (rate, 10**9 // rate)
    assert drive.sensors.scan_s <= 1 / rate


@every_preset
def test_what_is_measured_lies_on_the_beams(name: SensorName) -> None:
    drive, points = sweep(name)
    assert set(points.sensor.tolist()) == set(range(len(drive.sensors.lidars)))
    for number, lidar in enumerate(drive.sensors.lidars):
        elevation, azimuth, far = from_mount(name, number)
        beams = np.rad2deg(np.sort(lidar.elevation_rad))
        off = np.abs(beams - elevation[:, None]).min(axis=1)
        assert np.quantile(off, 0.99) < 0.02  # single precision, and a pose between two times
        met = np.abs(beams[:, None] - elevation[None, ::7]).argmin(axis=0)
        assert (np.bincount(met, minlength=len(beams)) > 0)[beams < 0].all()
        assert far.max() < lidar.reach_m + 0.5  # leaves are met inside
        fields = np.rad2deg([lidar.azimuth_rad.min(), lidar.azimuth_rad.max()])
        if fields[1] - fields[0] < 350:
            turn = (azimuth - fields.mean() + 180) % 360 - 180
            assert np.abs(turn).max() <= (fields[1] - fields[0]) / 2 + 0.01


@every_preset
def test_no_point_lies_inside_the_car(name: SensorName) -> None:
    _, points = sweep(name)
    x, y, z = points.xyz_ego_m.T
    in_length = (x > -AXLE_TO_REAR_M) & (x < CAR_LENGTH_M - AXLE_TO_REAR_M)
    assert not (in_length & (np.abs(y) < CAR_WIDTH_M / 2) & (z > -0.3) & (z < 1.6)).any()
    assert len(points) > 10_000


@every_preset
def test_ranges_have_the_noise_of_the_preset(name: SensorName) -> None:
    drive, points = sweep(name)
    noisy, _ = measured(caster(name), drive.sensors, 0.0, 1.0, np.random.default_rng([*drive._seed, 10, 0]))
    world = apply(drive.world_from_ego[0], points.xyz_ego_m)
    off = np.linalg.norm(noisy.xyz_world_m - world, axis=1)
    assert np.sqrt((off**2).mean()) == pytest.approx(drive.sensors.range_noise_m, rel=0.03)
    assert points.intensity.any() == drive.sensors.has_intensity


@every_preset
def test_labels_move_at_the_rate_of_the_preset(name: SensorName) -> None:
    labels = CityLabels(city(name)).labels("train-000")
    drive, _ = sweep(name)
    first, second = (labels[labels.frame == frame] for frame in (0, 1))
    pose = drive.world_from_ego
    world = [
        boxes.center_m @ pose[frame, :3, :3].T + pose[frame, :3, 3]
        for frame, boxes in enumerate((first, second))
    ]
    moved_mps = (world[1] - world[0]) * STATED[name][4]
    np.testing.assert_allclose(first.velocity_mps @ pose[0, :3, :3].T, moved_mps, atol=0.1)
    assert 1 < np.linalg.norm(moved_mps, axis=1).max() < 25


@every_preset
def test_points_move_with_their_objects(name: SensorName) -> None:
    drive = sweep(name)[0]
    points, truth = drive.points_with_truth(0)
    rigid = [
        n for n, thing in enumerate(drive.scene.things) if thing.motion.moves and len(thing.model.parts) == 1
    ]
    mine = np.isin(truth.thing, rigid)
    assert mine.sum() > 20
    turn, place = drive.world_from_ego[0][:3, :3], drive.world_from_ego[0][:3, 3]
    for number in np.unique(truth.thing[mine]):
        own = mine & (truth.thing == number)
        time_s = points.time_offset_ns[own] / 1e9
        here, then = (
            drive.scene.things[number].motion.at(time_s + late) for late in (0.0, 1 / drive.rate_hz)
        )
        world = points.xyz_ego_m[own] @ turn.T + place
        moved = (then.world(here.local(world)) - world) * drive.rate_hz
        # Leaves and noise aside, the point is where its surface is.
        np.testing.assert_allclose(truth.velocity_mps[own] @ turn.T, moved, atol=0.05)


def test_the_second_of_two_stacked_ones_is_upside_down_and_half_a_turn_late() -> None:
    first, second = SENSORS["twin32"].lidars
    np.testing.assert_allclose(np.sort(first.elevation_rad), np.sort(-second.elevation_rad))
    behind = np.abs((first.azimuth_rad - second.azimuth_rad) % (2 * np.pi))
    np.testing.assert_allclose(behind, np.pi)


def test_lines_are_drawn_from_the_top() -> None:
    drive, points = sweep("solid_state")
    elevation, _, _ = from_mount("solid_state", 0)
    rows = np.rint((12.5 - elevation) / 0.2)
    expected = ((rows + 0.5) / 126 - 0.5) * 0.1
    assert np.quantile(np.abs(points.time_offset_ns / 1e9 - expected), 0.99) < 1e-3
    assert drive.trigger_s("side-left") == 0


@pytest.mark.parametrize("name", ["waymo", "twin32", "solid_state"])
def test_returns_are_those_of_their_own_rays(name: SensorName) -> None:
    preset = SENSORS[name]
    returns, hits = measured(caster(name), preset, 0.0, 0.0, np.random.default_rng(0))
    rays, sensor = rays_at(caster(name), preset, 0.0)
    some = slice(None, None, 101)
    own = rays.chosen(returns.ray[some])
    np.testing.assert_allclose(caster(name).cast(own, reach_m=250.0).range_m, hits.range_m[some], rtol=1e-3)
    assert (sensor[returns.ray] == returns.sensor).all()
