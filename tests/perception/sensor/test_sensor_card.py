"""The sensor card: the beams, the place and the turn of LiDARs that are known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ray_street import CONFIG, STEP_NS, Lidar, drive_sample
from upvl_cli.geometry.se3 import from_yaw
from upvl_cli.perception.sensor.beams import beams_by_histogram, beams_by_order
from upvl_cli.perception.sensor.coverage import hidden_sectors
from upvl_cli.perception.sensor.intensity import measure_intensity
from upvl_cli.perception.sensor.limits import differences, limits, person_reach_m
from upvl_cli.perception.sensor.measure import measure_sensor
from upvl_cli.perception.sensor.origin import beam_contrast, elevations_deg, find_origin
from upvl_cli.perception.sensor.turn import field_of_view_deg, sense_of_turn
from upvl_cli.types import Camera, Image, Points, concat

SENSOR = CONFIG.sensor
VELODYNE_64 = tuple([*np.linspace(-24.8, -8.8, 32), *np.linspace(-8.3, 2.0, 32)])
PANDAR_40 = tuple([-16, -13, *np.arange(-11, -6.1, 1.0), *np.linspace(-5.67, 2, 24), *np.arange(3, 11, 1.0)])


@pytest.mark.parametrize(
    "lidar",
    [
        Lidar(beams_deg=tuple(np.linspace(-15, 15, 16)), columns=1800),
        Lidar((1.2, 0.0, 1.9), tuple(np.linspace(-30, 10, 32))),
        Lidar((0.9, -0.2, 2.1), VELODYNE_64),
        Lidar((0.9, 0.0, 2.1), VELODYNE_64, by_beam=True),
        Lidar((0.0, 0.0, 1.7), PANDAR_40),
        Lidar((0.0, 0.0, 0.55), tuple(np.linspace(-15, 15, 32))),
        Lidar((2.0, 0.0, 3.4), tuple(np.linspace(-22, 12, 128)), columns=600),
    ],
)
def test_beams_and_place_of_a_lidar_come_back(lidar: Lidar) -> None:
    card = measure_sensor(drive_sample([lidar]), SENSOR)
    found = card.lidars[0]
    beams = np.array(lidar.beams_deg)
    nearest = np.abs(np.subtract.outer(found.beams_deg, beams)).argmin(axis=1)
    np.testing.assert_allclose(found.beams_deg, beams[nearest], atol=0.1)
    assert len(set(nearest)) == len(nearest)
    # Others meet the sky, or the road within 2.5 m.
    inside = (beams > found.elevation_deg[0] + 0.1) & (beams < found.elevation_deg[1] - 0.1)
    assert set(np.flatnonzero(inside)) <= set(nearest)
    np.testing.assert_allclose(found.origin_m, lidar.origin_m, atol=0.06)
    assert found.height_m == pytest.approx(lidar.origin_m[2], abs=0.06)
    assert found.azimuth_step_deg == pytest.approx(360 / lidar.columns, rel=0.1)
    assert found.field_of_view_deg == 360 and found.sense == "clockwise"


def test_two_lidars_are_told_apart() -> None:
    top = Lidar((1.3, 0.0, 1.9), tuple(np.linspace(-25, 15, 32)))
    front = Lidar((3.5, 0.0, 0.8), tuple(np.linspace(-12, 3, 16)), field_deg=120, sense=1, sensor=3)
    card = measure_sensor(drive_sample([top, front]), SENSOR)
    assert [lidar.sensor for lidar in card.lidars] == [0, 3]
    assert card.main_lidar is card.lidars[0]
    second = card.lidars[1]
    assert second.field_of_view_deg == pytest.approx(120, abs=2) and abs(second.direction_deg) < 2
    assert second.sense == "counter-clockwise"
    np.testing.assert_allclose(second.origin_m, front.origin_m, atol=0.06)


def test_axes_of_the_lidar_are_kept_as_its_place() -> None:
    card = measure_sensor(drive_sample(axes_z_m=1.8), SENSOR)
    assert card.lidars[0].origin_m == (0.0, 0.0, 0.0)
    assert card.road_z_m == pytest.approx(-1.8, abs=0.05)
    assert card.lidars[0].height_m == pytest.approx(1.8, abs=0.05)


def test_beams_of_a_moving_car_are_seen_from_where_it_was() -> None:
    """Compensated points of one turn were seen from a metre of road."""
    sample = drive_sample([Lidar((1.0, 0.0, 1.9), VELODYNE_64)], _compensated, frames=4)
    poses = np.array([from_yaw(0.0, np.array([10.0 * step * 0.1, 0, 0])) for step in range(4)])
    still = measure_sensor(sample, SENSOR).lidars[0]
    moving = measure_sensor(replace(sample, world_from_ego=poses), SENSOR).lidars[0]
    assert len(moving.beams_deg) >= 60
    np.testing.assert_allclose(moving.origin_m, (1.0, 0.0, 1.9), atol=0.06)
    assert len(still.beams_deg) < len(moving.beams_deg)


def _compensated(points: Points, step: int) -> Points:
    shift = points.time_offset_ns[:, None] * 1e-9 * np.array([10.0, 0, 0])
    return replace(points, xyz_ego_m=points.xyz_ego_m + shift)


def test_points_without_beams_have_none() -> None:
    rng = np.random.default_rng(0)
    xyz = rng.uniform([-40, -40, 0.0], [40, 40, 3.0], (6000, 3))
    assert find_origin(xyz, np.zeros_like(xyz), 0.0, 6000)[1] < SENSOR.min_beam_contrast
    card = measure_sensor(drive_sample(change=lambda points, step: _at(points, xyz)), SENSOR)
    assert card.lidars[0].beams_deg == () and card.lidars[0].beam_step_deg is None
    assert "beams: cannot tell" in card.lidars[0].lines[0]


def _at(points: Points, xyz: np.ndarray) -> Points:
    return replace(points[: len(xyz)], xyz_ego_m=xyz)


def test_a_drive_without_points_has_a_card() -> None:
    card = measure_sensor(drive_sample(change=lambda points, step: points[:0]), SENSOR)
    assert card.lidars == () and card.main_lidar is None
    assert limits(card, SENSOR) == ("no point at all: nothing can be labelled",)


def test_order_of_the_file_gives_the_beams() -> None:
    azimuth = np.tile(np.arange(-180, 180, 0.5), 16)
    elevation = np.repeat(np.linspace(-15, 15, 16), 720)
    for shift in (0, 300):
        beams = beams_by_order(np.roll(azimuth, shift), np.roll(elevation, shift))
        assert beams is not None
        np.testing.assert_allclose(beams, np.linspace(-15, 15, 16), atol=1e-6)
    assert beams_by_order(np.random.default_rng(0).permutation(azimuth), elevation) is None
    assert beams_by_order(azimuth[:1], elevation[:1]) is None


def test_peaks_that_depend_on_the_smoothing_are_no_beams() -> None:
    assert beams_by_histogram(np.random.default_rng(0).uniform(-20, 5, 20_000)) is None
    assert beam_contrast(np.zeros(0), 0.05) == 1.0
    assert elevations_deg(np.array([[1.0, 0, 1.0]]), np.zeros(3))[0] == pytest.approx(45)


def test_sense_of_turn() -> None:
    azimuth = np.linspace(-180, 180, 3600, endpoint=False)
    time_ns = np.arange(3600)
    assert sense_of_turn(azimuth, time_ns) == "counter-clockwise"
    assert sense_of_turn(azimuth, -time_ns) == "clockwise"
    assert sense_of_turn(np.tile(azimuth[::36], 36), time_ns) == "unknown"  # beam by beam
    assert sense_of_turn(azimuth, np.zeros(3600)) == "unknown"


def test_field_of_view_and_hidden_sectors() -> None:
    azimuth = np.concatenate([np.arange(100, 180, 0.1), np.arange(-180, -99, 0.1)])
    width, middle = field_of_view_deg(azimuth)
    assert width == pytest.approx(161, abs=2) and abs(abs(middle) - 180) < 2
    assert field_of_view_deg(np.zeros(0)) == (0.0, 0.0)
    around = np.arange(-180, 180, 0.1)
    around = around[(around < 100) | (around >= 120)]
    assert hidden_sectors(around, np.full(len(around), 9.0), (360.0, 0.0), SENSOR) == ((100.0, 120.0),)
    across = np.arange(-170, 170, 0.1)
    assert hidden_sectors(across, np.full(len(across), 9.0), (360.0, 0.0), SENSOR) == ((170.0, -170.0),)


@pytest.mark.parametrize(
    ("values", "scale", "bits"),
    [
        (np.zeros(50), "none", 0),
        (np.full(50, 0.5), "constant", 0),
        (np.linspace(0, 0.977, 999), "0 to 1", 0),
        (np.arange(256) / 255, "0 to 1", 8),
        (np.arange(256.0), "0 to 255", 8),
        (np.arange(0, 65536, 37.0), "0 to 65535", 16),
        (np.array([-0.5, 0.5]), "unknown", 0),
        (np.array([np.nan, 0.5]), "unknown", 0),
        (np.zeros(0), "none", 0),
    ],
)
def test_scale_of_intensities(values: np.ndarray, scale: str, bits: int) -> None:
    found = measure_intensity([values])
    assert (found.scale, found.bits) == (scale, bits)


def test_the_card_is_plain_json_and_lines() -> None:
    card = measure_sensor(drive_sample(), SENSOR)
    assert json.loads(json.dumps(card.to_json()))["lidars"][0]["sensor"] == 0
    text = dict(card.lines)
    assert text["sweeps"] == "16 frames, 10.00 Hz, jitter 0.0%, points over 100 ms"
    assert any("32 beams" in line for _, line in card.lines)


def test_what_few_beams_and_rare_sweeps_cannot_give() -> None:
    coarse = Lidar(beams_deg=tuple(np.linspace(-15, 15, 16)), columns=1800)
    few, many = (
        measure_sensor(drive_sample([lidar]), SENSOR) for lidar in (coarse, Lidar(beams_deg=VELODYNE_64))
    )
    reach_few, reach_many = person_reach_m(few, SENSOR), person_reach_m(many, SENSOR)
    assert reach_few is not None and reach_many is not None and 10 < reach_few < reach_many
    (sentence,) = limits(few, SENSOR)
    assert "2.0 degrees apart: pedestrians beyond" in sentence
    slow = limits(replace(many, rate_hz=2.0), SENSOR)[0]
    assert slow.startswith("2.0 Hz: at 10 m/s an object moves 5.0 m")
    assert limits(replace(many, rate_hz=50.0), SENSOR)[0].startswith("50.0 Hz")
    assert limits(replace(many, rate_hz=None), SENSOR)[0].startswith("one frame")


def test_drives_of_other_scales_and_beams_are_named() -> None:
    usual = measure_sensor(drive_sample(), SENSOR)
    lidar = usual.lidars[0]
    loud = replace(usual, lidars=(replace(lidar, intensity=measure_intensity([np.arange(256.0)])),))
    thin = replace(usual, lidars=(replace(lidar, beams_deg=lidar.beams_deg[::2]),), rate_hz=2.0)
    assert differences({"a": usual, "b": usual}) == ()
    assert differences({"a": usual}) == ()
    assert differences({"a": usual, "b": loud, "c": usual}) == (
        "b: intensities reach 255, those of other drives 0.99",
    )
    assert len(differences({"a": usual, "b": thin, "c": usual})) == 2


def test_the_car_itself_is_what_stays_while_the_scene_changes() -> None:
    roof = np.stack(np.meshgrid(np.linspace(-1.15, 0.85, 20), np.linspace(-0.75, 0.65, 8)), -1).reshape(-1, 2)

    def add(points: Points, step: int) -> Points:
        rng = np.random.default_rng(step)
        places = np.column_stack([roof, np.full(len(roof), 1.5)]) + rng.normal(0, 0.01, (len(roof), 3))
        return concat([points, _at(points, places)], Points)

    car = measure_sensor(drive_sample(change=add, frames=40), SENSOR).car
    assert car is not None
    np.testing.assert_allclose([*car.x_m, *car.y_m], [-1.2, 0.9, -0.8, 0.7], atol=0.11)
    assert measure_sensor(drive_sample(frames=40), SENSOR).car is None
    standing = measure_sensor(drive_sample(change=add, frames=40, speed_mps=0.0), SENSOR)
    assert standing.car is None and not standing.car_drives


def test_a_camera_is_described() -> None:
    camera = Camera(
        "left", 400, 300, np.array([[200.0, 0, 199.5], [0, 200, 149.5], [0, 0, 1]]), np.zeros(5),
        np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]),
    )  # fmt: skip
    taken = Image(np.zeros((300, 400, 3), np.uint8), 20_000_000)
    sample = replace(drive_sample(), cameras=(camera,), picture=lambda step, name: taken)
    found = measure_sensor(sample, SENSOR).cameras[0]
    assert found.direction_deg == pytest.approx(90) and found.field_of_view_deg == pytest.approx(90, abs=0.1)
    assert found.delay_s == pytest.approx(0.02) and 0.1 < found.points_share < 0.4
    assert "+20 ms after its sweep" in found.line
    assert sample.frames[1].time_ns == STEP_NS
