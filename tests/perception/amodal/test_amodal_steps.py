"""Each step of the fit of amodal boxes, on numbers that can be checked by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting
from upvl_cli.geometry.se3 import apply, from_yaw, yaw_of
from upvl_cli.perception.amodal.completion import anchor, complete_center, shown_sides
from upvl_cli.perception.amodal.edges import attained, trimmed_edges, trimmed_extent
from upvl_cli.perception.amodal.fit import fit_amodal_boxes
from upvl_cli.perception.amodal.heading import headings
from upvl_cli.perception.amodal.residual import cloud_residual_m
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.amodal.size_prior import whole_size
from upvl_cli.perception.amodal.track_registration import register_track
from upvl_cli.perception.amodal.vertical import ground_level, vertical_extent
from upvl_cli.stages.amodal import AmodalConfig
from upvl_cli.types import Array, Boxes

CONFIG = load(AmodalConfig, Path(__file__).parents[3] / "stages" / "amodal.toml")
UNREGISTERED = replace(CONFIG, registration=replace(CONFIG.registration, enabled=False))


def seen(
    clouds: list[Array],
    heights: list[Array] | None = None,
    velocity_mps: Array | None = None,
    sensor_xy_m: tuple[float, float] = (0.0, 0.0),
    ego_heading_rad: float = 0.0,
    center_m: Array | None = None,
) -> Sightings:
    """An object seen in some frames; the ground is at z = 0 where nothing else is said."""
    n = len(clouds)
    rows = np.tile([0.0, 0, 1.0, 4, 2, 2, 0], (n, 1))
    if center_m is not None:
        rows[:, :3] = center_m
    return Sightings(
        np.arange(n) * 0.1,
        clouds,
        heights if heights is not None else [cloud[:, 2] for cloud in clouds],
        Boxes.from_rows(rows),
        velocity_mps if velocity_mps is not None else np.zeros((n, 3)),
        np.tile(sensor_xy_m, (n, 1)).astype(float),
        np.full(n, ego_heading_rad),
    )


def wall(
    start: tuple[float, float], end: tuple[float, float], low_m: float = 0.4, high_m: float = 1.5
) -> Array:
    """A grid of points on an upright rectangle."""
    share, z = np.meshgrid(np.linspace(0, 1, 41), np.linspace(low_m, high_m, 12))
    flat = np.array(start) + share.reshape(-1, 1) * (np.array(end) - np.array(start))
    return np.column_stack([flat, z.ravel()])


# Edges


@pytest.mark.parametrize(
    ("share", "expected"),
    [(0.1, 9.0), (0.2, 9.0), (0.21, 8.0), (0.3, 8.0), (1.0, 1.0)],  # of ten frames, two at least
)
def test_an_edge_is_attained_by_a_share_of_the_frames_and_by_two_at_least(
    share: float, expected: float
) -> None:
    values = np.random.default_rng(0).permutation(np.arange(1.0, 11.0))
    assert attained(np.append(values, np.nan), share) == expected


def test_edges_of_one_frame_are_its_own_and_of_none_zero() -> None:
    np.testing.assert_array_equal(attained(np.array([[3.0, 4.0]]), 0.1), [3, 4])
    np.testing.assert_array_equal(attained(np.array([[3.0, 4.0], [5.0, 1.0]]), 0.1), [3, 1])
    np.testing.assert_array_equal(attained(np.full((2, 2), np.nan), 0.1), [0, 0])


def test_stray_points_are_left_out_of_edges_and_few_points_have_none() -> None:
    line = np.column_stack([np.linspace(0, 1, 1001), np.linspace(0, 2, 1001), np.zeros(1001)])
    line[0, 0], line[-1, 1] = -50, 70
    low, high = trimmed_edges([line, line[:2], line[100:103]], 0.01)
    np.testing.assert_allclose([low[0], high[0]], [[0.01, 0.02], [0.99, 1.98]], atol=1e-3)
    assert np.isnan(low[1]).all()
    assert np.isnan(high[1]).all()
    assert np.isfinite(low[2]).all(), "three points have an extent"
    np.testing.assert_allclose(trimmed_extent(line[:, :2], 0.01), [0.98, 1.96], atol=1e-3)


# Sizes and centers


def whole(
    seen_m: tuple[float, float, float],
    *,
    shown: tuple[bool, bool, bool] = (True, True, True),
    speed_mps: float = 0.0,
) -> Array:
    """The size of a thing of which that much was seen."""
    return whole_size(np.array(seen_m), np.array(shown), speed_mps, CONFIG.size)


def test_the_end_of_a_car_is_completed_to_a_car_and_a_whole_car_keeps_its_length() -> None:
    end = whole((0.3, 1.8, 1.5), shown=(False, True, True))
    assert 4.0 < end[0] < 4.8
    assert end[1] == pytest.approx(1.85, abs=0.08)
    for length_m in (3.9, 4.4, 4.9):
        found = whole((0.975 * length_m, 1.8, 1.5))
        assert found[0] == pytest.approx(length_m, abs=0.2), (
            "little but the shortfall of round edges is added"
        )
    assert whole((4.3, 0.4, 1.5), shown=(True, False, True))[1] == pytest.approx(1.85, abs=0.1)


def test_a_walker_stays_a_walker_and_a_fast_one_rides() -> None:
    walker = whole((0.4, 0.5, 1.7))
    assert 0.4 <= walker[0] < 1.1
    assert walker[1] < 0.8
    rider = whole((0.9, 0.5, 1.7), shown=(False, True, True), speed_mps=6.0)
    assert 1.6 < rider[0] < 2.4
    assert rider[1] < 0.9


def test_the_end_of_a_bus_is_longer_than_that_of_a_car_and_what_fits_no_kind_is_as_seen() -> None:
    assert whole((0.5, 2.6, 3.2), shown=(False, True, True))[0] > 6.0
    np.testing.assert_allclose(whole((14.0, 0.2, 0.9)), (14.0, 0.2, 0.9), atol=0.05)


def test_a_size_is_never_below_what_was_seen() -> None:
    rng = np.random.default_rng(0)
    for seen_m in rng.uniform(0.1, 12, (200, 3)):
        assert (whole(tuple(seen_m)) >= seen_m).all()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("size", {"car": {"mean_lwh_m": [4.5, 1.9]}}, "mean_lwh_m"),
        ("size", {"child": {"spread_lwh_m": [1.0] * 4}}, "spread_lwh_m"),
        ("objectness", {"ring_m": [1.5, 0.7]}, "ring_m"),
        ("objectness", {"ring_height_m": [0.3]}, "ring_height_m"),
    ],
)
def test_a_setting_of_another_length_is_one_line(key: str, value: dict[str, object], message: str) -> None:
    path = Path(__file__).parents[3] / "stages" / "amodal.toml"
    with pytest.raises(BadSetting, match=message):
        load(AmodalConfig, path, {key: value})


def test_a_side_shows_from_an_angle_on_and_in_frames_with_points() -> None:
    size_m = np.array([4.0, 2.0])
    ahead, corner = np.array([20.0, 0.0]), np.array([10.0, 8.0])
    few = np.array([10, 100])
    np.testing.assert_array_equal(
        shown_sides(size_m, np.array([ahead, ahead]), few, CONFIG.size), [True, False, False, False]
    )
    np.testing.assert_array_equal(
        shown_sides(size_m, np.array([-corner, ahead]), few, CONFIG.size), [True, False, False, False]
    )
    np.testing.assert_array_equal(
        shown_sides(size_m, np.array([ahead, -corner]), few, CONFIG.size), [False, True, False, True]
    )
    grazing = np.array([[-10.0, 1.0 + 10.0 * np.tan(np.deg2rad(10))]])
    assert not shown_sides(size_m, grazing, np.array([9]), CONFIG.size)[2]


@pytest.mark.parametrize(
    ("sensor_m", "center_m"),
    [
        ((-10.0, -10.0), (2.0, 1.0)),  # behind and right of it: the rest is ahead and left
        ((10.0, -10.0), (-1.0, 1.0)),
        ((10.0, 10.0), (-1.0, 0.0)),
    ],
)
def test_of_a_vehicle_the_hidden_part_lies_behind_the_edges_that_face_the_sensor(
    sensor_m: tuple[float, float], center_m: tuple[float, float]
) -> None:
    low, high = np.array([[0.0, 0.0]]), np.array([[1.0, 1.0]])
    found = complete_center(low, high, np.array([sensor_m]), np.array([4.0, 2.0]), is_vehicle=True)
    np.testing.assert_allclose(found[0], center_m)


def test_beside_the_sensor_either_end_of_a_vehicle_may_be_hidden() -> None:
    low, high = np.array([[-1.0, 0.0]]), np.array([[1.0, 1.0]])
    found = complete_center(low, high, np.array([[0.0, -10.0]]), np.array([4.0, 2.0]), is_vehicle=True)
    np.testing.assert_allclose(found[0], [0.0, 1.0])
    found = complete_center(low, high, np.array([[1.0, -10.0]]), np.array([4.0, 2.0]), is_vehicle=True)
    np.testing.assert_allclose(found[0], [-0.5, 1.0])


def test_of_a_person_the_rest_is_along_the_line_of_sight() -> None:
    low, high = np.array([[-0.1, -0.1]]), np.array([[0.1, 0.1]])
    found = complete_center(low, high, np.array([[-3.0, -4.0]]), np.array([1.0, 1.0]), is_vehicle=False)
    np.testing.assert_allclose(found[0], [0.6 * 0.4, 0.8 * 0.4])
    assert np.isfinite(complete_center(low, high, np.zeros((1, 2)), np.ones(2), is_vehicle=False)).all()


def test_faces_turned_to_the_sensor_take_the_drift_out_of_a_registration() -> None:
    time_s = np.arange(21) * 0.1
    true = np.column_stack([np.zeros(21), np.zeros(21)])
    registered = true + np.column_stack([0.02 * np.arange(21), np.zeros(21)])  # drifts along
    rng = np.random.default_rng(1)
    faced = true + rng.normal(0, 0.1, (21, 2))
    faced[:, 1] = np.nan  # no face across
    faced[::4, 0] = np.nan
    registered[7] = np.nan
    fallback = np.full((21, 2), 9.0)
    found = anchor(registered, faced, time_s, 1.0, fallback=fallback)
    np.testing.assert_array_equal(found[7], [9, 9])
    kept = np.delete(np.arange(21), 7)
    assert np.abs(found[kept, 0]).max() < 0.2
    assert np.abs(registered[kept, 0]).max() == pytest.approx(0.4)
    np.testing.assert_array_equal(found[kept, 1], registered[kept, 1])
    # A plain loop over frames gives the same.
    for number in kept:
        near = (
            (np.abs(time_s - time_s[number]) <= 0.5 + 1e-9)
            & np.isfinite(faced[:, 0])
            & np.isfinite(registered[:, 0])
        )
        expected = registered[number, 0] + np.median((faced - registered)[near, 0])
        assert found[number, 0] == pytest.approx(expected, abs=0.1)


def test_the_residual_is_the_distance_of_the_clouds_to_the_densest() -> None:
    side = wall((0.0, 0.0), (4.0, 0.0))
    moved = side + [0.0, 0.1, 0.0]
    found = cloud_residual_m([side, moved[::2], moved[1::2]], {number: np.eye(4) for number in range(3)})
    assert found == pytest.approx(0.1, abs=1e-9)
    assert cloud_residual_m([side], {0: np.eye(4)}) == -1


# Where it stands


def columns_of(lows_m: list[float], high_m: float = 1.8, ground_m: list[float] | None = None) -> Sightings:
    """Upright rows of points over some ground, one a frame."""
    clouds, heights = [], []
    for number, low_m in enumerate(lows_m):
        height = np.linspace(low_m, high_m, 9) if np.isfinite(low_m) else np.zeros(0)
        floor_m = ground_m[number] if ground_m else 0.0
        clouds.append(np.column_stack([np.zeros((len(height), 2)), height + floor_m]))
        heights.append(height)
    return seen(clouds, heights)


def test_what_shows_its_foot_in_some_frames_stands_on_the_ground_in_all() -> None:
    floor_m, height_m = vertical_extent(columns_of([0.1, 0.2, 1.6, 1.6, 1.6]), CONFIG, moves=True)
    np.testing.assert_allclose(floor_m, 0)
    assert height_m == pytest.approx(1.8)
    # One frame is none: two show a foot, or nobody does.
    floor_m, height_m = vertical_extent(columns_of([0.1, 1.6, 1.6, 1.7, 1.7], high_m=2.0), CONFIG, moves=True)
    np.testing.assert_allclose(floor_m, 1.6)
    assert height_m == pytest.approx(0.4)


@pytest.mark.parametrize(("low_m", "floor_m"), [(1.4, 0.0), (1.5, 1.5)])
def test_what_is_never_seen_low_hangs(low_m: float, floor_m: float) -> None:
    found, height_m = vertical_extent(columns_of([low_m] * 4, high_m=2.5), CONFIG, moves=True)
    np.testing.assert_allclose(found, floor_m)
    assert height_m == pytest.approx(2.5 - floor_m)


def test_the_floor_is_a_low_percentile_of_the_ground_around_it_in_time() -> None:
    """Where the object hides the ground it is taken for it: that is too high, and lasts for some frames."""
    ground_m = [0.0, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0]
    floor_m, _ = vertical_extent(columns_of([0.1] * 11, ground_m=ground_m), CONFIG, moves=True)
    np.testing.assert_allclose(floor_m, 0, atol=0.06)
    floor_m, _ = vertical_extent(columns_of([0.1] * 11, ground_m=ground_m), CONFIG, moves=False)
    np.testing.assert_allclose(floor_m, 0, atol=1e-9)


@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.2, 0.5])
def test_on_a_slope_the_floor_rises_with_the_road_at_any_rate(step_s: float) -> None:
    time_s = np.arange(40) * step_s
    slope_m = 0.1 * 8.0 * time_s  # 10 % at 8 m/s
    np.testing.assert_allclose(ground_level(time_s, slope_m, CONFIG.ground), slope_m, atol=1e-9)
    hidden_m = slope_m + 0.4 * (np.arange(40) % 3 == 0)
    found_m = ground_level(time_s, hidden_m, CONFIG.ground)
    assert np.abs(found_m - slope_m).max() < 0.1


def test_the_floor_of_frames_without_points_is_between_those_around_them() -> None:
    nan = float("nan")
    config = replace(CONFIG, ground=replace(CONFIG.ground, window_s=0.0, min_window_frames=1))
    found = columns_of([0.1, 0.1, nan, nan, 0.1], ground_m=[0.0, 0.0, 9.0, 9.0, 0.6])
    floor_m, _ = vertical_extent(found, config, moves=True)
    np.testing.assert_allclose(floor_m, [0, 0, 0.2, 0.4, 0.6])


def test_without_any_points_the_boxes_of_the_track_stand_where_they_are() -> None:
    floor_m, height_m = vertical_extent(columns_of([float("nan")] * 3), CONFIG, moves=True)
    np.testing.assert_allclose(floor_m, 0)
    assert height_m == 2.0


# Heading


def test_a_heading_is_that_of_the_motion_and_is_held_through_stops() -> None:
    velocity = np.zeros((7, 3))
    velocity[1, :2], velocity[2, :2] = [-3.0, 0.1], [-3.0, -0.1]  # across the seam of angles
    velocity[5, :2] = [0.8, -0.6]  # 1 m/s: just fast enough
    velocity[6, :2] = [0.7, 0.7]  # 0.99 m/s
    center_m = np.column_stack([-np.arange(7.0), np.zeros(7), np.ones(7)])
    found, moves = headings(
        seen([np.zeros((0, 3))] * 7, velocity_mps=velocity, center_m=center_m), [], CONFIG
    )
    assert moves
    first, second = np.arctan2(0.1, -3), 2 * np.pi + np.arctan2(-0.1, -3)
    last = 2 * np.pi + np.arctan2(-0.6, 0.8)
    np.testing.assert_allclose(found[:3], [first, first, second])
    np.testing.assert_allclose(found[[3, 4]], second + (last - second) * np.array([1, 2]) / 3)
    np.testing.assert_allclose(found[[5, 6]], last)


@pytest.mark.parametrize(
    ("steps_m", "fast_frames", "moves"),
    [
        ([0.5] * 9, 9, True),
        ([0.5] * 9, 1, False),  # one noisy frame
        ([0.5, -0.5] * 5, 9, False),  # to and fro
        ([0.15] * 9, 9, False),  # 1.35 m: less than half of its length of 4 m
    ],
)
def test_what_moves_does_so_in_many_frames_and_gets_somewhere(
    steps_m: list[float], fast_frames: int, moves: bool
) -> None:
    center_m = np.zeros((len(steps_m) + 1, 3))
    center_m[1:, 0] = np.cumsum(steps_m)
    velocity = np.zeros((len(center_m), 3))
    velocity[:fast_frames, 0] = 2.0
    cloud = wall((10.0, -1.0), (10.0, 1.0))
    sightings = seen([cloud] * len(center_m), velocity_mps=velocity, center_m=center_m)
    assert headings(sightings, sightings.xyz_m, CONFIG)[1] == moves


@pytest.mark.parametrize(
    ("ego_rad", "expected_rad"), [(0.0, 0.4), (2.0, 0.4 + np.pi), (-1.0, 0.4), (3.0, 0.4 + np.pi)]
)
def test_of_both_ways_a_parked_thing_points_the_one_nearer_to_the_ego_heading(
    ego_rad: float, expected_rad: float
) -> None:
    way = np.array([np.cos(0.4), np.sin(0.4)])
    side = wall(tuple(-2 * way), tuple(2 * way))
    found = headings(seen([side], sensor_xy_m=(3.0, -9.0), ego_heading_rad=ego_rad), [side], CONFIG)
    if np.cos(0.4 - ego_rad) >= 0:
        assert found[0] == pytest.approx(0.4, abs=0.02)
    else:
        assert found[0] == pytest.approx(0.4 + np.pi, abs=0.02)


@pytest.mark.parametrize(
    ("face_m", "high_m", "along_sight"),
    [
        (1.1, 1.5, False),  # no wider than a cyclist: its long side
        (1.3, 1.5, True),  # the end of a car
        (2.1, 1.5, True),
        (2.3, 1.5, False),  # wider than any car: its side
        (2.3, 2.2, False),
        (2.3, 2.3, True),  # as high as a van: its end
        (2.9, 3.0, True),
        (3.1, 3.0, False),
    ],
)
def test_a_face_as_wide_as_a_vehicle_is_its_end(face_m: float, high_m: float, along_sight: bool) -> None:
    """A wall across the sight, 10 m ahead: is the object seen from its end, or from its side?"""
    half = face_m / 2 / 0.98  # a hundredth of the points is left out at each end
    face = wall((10.0, -half), (10.0, half), high_m=high_m)
    found = headings(seen([face]), [face], CONFIG)[0][0]
    assert abs(np.cos(found)) == pytest.approx(1.0 if along_sight else 0.0, abs=0.02)


@pytest.mark.parametrize(("upper_m", "along_sight"), [(0.7, False), (0.9, True)])
def test_what_is_slim_above_is_a_person_and_no_end(upper_m: float, along_sight: bool) -> None:
    low = wall((10.0, -0.8), (10.0, 0.8), 0.4, 1.2)
    high = wall((10.0, -upper_m / 2), (10.0, upper_m / 2), 1.3, 1.8)  # above 0.7 of 1.8 m is 1.26 m
    cloud = np.vstack([low, high])
    found = headings(seen([cloud]), [cloud], CONFIG)[0][0]
    assert abs(np.cos(found)) == pytest.approx(1.0 if along_sight else 0.0, abs=0.02)


def test_two_points_have_the_heading_of_the_car_that_sees_them() -> None:
    points = np.array([[9.0, 0, 1], [9.0, 1, 1]])
    assert headings(seen([points], ego_heading_rad=0.7), [points], CONFIG)[0][0] == 0.7


# Registration


def corner(points: int) -> Array:
    """An L of points about its own center, as a car shows it."""
    share = np.linspace(0, 1, points)
    side = np.column_stack([4 * share - 2, np.full(points, -0.9), 0.5 + share % 0.2])
    end = np.column_stack([np.full(points, -2.0), 1.8 * share - 0.9, 0.5 + share % 0.3])
    return np.vstack([side, end])


def test_clouds_are_laid_on_the_densest_one_and_those_that_differ_stay_out() -> None:
    model = corner(60)
    shifts = [from_yaw(yaw, np.array([x, y, 0.0])) for yaw, x, y in
              ((0.02, 0.1, 0.0), (0.0, 0.0, 0.0), (-0.03, 0.0, 0.1), (0.05, -0.1, 0.1))]  # fmt: skip
    clouds = [apply(shift, model[:: 1 if number == 1 else 2]) for number, shift in enumerate(shifts)]
    clouds += [model[:7], np.random.default_rng(0).uniform(-9, 9, (40, 3))]
    found = register_track(clouds, CONFIG.registration)
    assert sorted(found) == [0, 1, 2, 3]
    np.testing.assert_array_equal(found[1], np.eye(4), "the densest stays where it is")
    for number, shift in enumerate(shifts):
        back = found[number] @ shift
        np.testing.assert_allclose(back, np.eye(4), atol=0.08)


def test_each_frame_starts_from_the_motion_of_its_neighbor() -> None:
    """Clouds that turn away step by step are followed outward; out of turn the last is too far off."""
    model = corner(60)
    angles = [0.0, 0.09, 0.18, 0.27]
    drift = [from_yaw(angle, np.array([8 * angle, 0.0, 0.0])) for angle in angles]
    clouds = [apply(move, model[:: 1 if not number else 2]) for number, move in enumerate(drift)]
    found = register_track(clouds, CONFIG.registration)
    assert sorted(found) == [0, 1, 2, 3]
    assert -yaw_of(found[3]) == pytest.approx(0.27, abs=0.03)
    # The same to the other side of the densest.
    found = register_track(clouds[::-1], CONFIG.registration)
    assert sorted(found) == [0, 1, 2, 3]
    assert -yaw_of(found[0]) == pytest.approx(0.27, abs=0.03)


def test_fewer_registered_frames_than_enough_are_none() -> None:
    three = [corner(40)] * 3
    assert register_track(three, CONFIG.registration) == {}
    assert sorted(register_track([*three, corner(40)], CONFIG.registration)) == [0, 1, 2, 3]
    assert register_track([], CONFIG.registration) == {}
    assert register_track([corner(3)[:5]] * 9, CONFIG.registration) == {}, "too few points in each"
    assert register_track([corner(40)] * 9, replace(CONFIG.registration, enabled=False)) == {}


# All together


def test_points_on_the_ground_have_no_say_in_length_and_width() -> None:
    body = wall((8.0, -1.0), (8.0, 1.0))
    kerb = wall((8.0, -5.0), (8.0, 5.0), 0.0, 0.29)
    box = fit_amodal_boxes(seen([np.vstack([body, kerb])] * 3), UNREGISTERED).boxes
    assert 4.0 < box.size_lwh_m[0, 0] < 4.8, "the length of a car"
    assert box.size_lwh_m[0, 1] == pytest.approx(2.0, abs=0.1)
    # Where there is nothing else they are all there is.
    box = fit_amodal_boxes(seen([kerb] * 3), UNREGISTERED).boxes
    assert box.size_lwh_m[0, 0] > 9


def test_frames_that_show_nothing_lie_between_those_around_them() -> None:
    velocity = np.tile([5.0, 0, 0], (5, 1))
    center = np.column_stack([np.arange(5) * 0.5, np.full(5, 6.0), np.full(5, 1.0)])
    side = wall((-2.0, 5.1), (2.0, 5.1))
    clouds = [side + [0.5 * number + 0.1 * number, 0, 0] for number in range(5)]  # it runs ahead of its track
    clouds[2] = np.zeros((0, 3))
    sightings = seen(clouds, velocity_mps=velocity, center_m=center, sensor_xy_m=(-50.0, 0.0))
    boxes = fit_amodal_boxes(sightings, UNREGISTERED).boxes
    np.testing.assert_allclose(
        boxes.center_m[2, :2], (boxes.center_m[1, :2] + boxes.center_m[3, :2]) / 2, atol=1e-9
    )
    np.testing.assert_allclose(np.diff(boxes.center_m[:, 0]), 0.6, atol=1e-9)
    assert (boxes.size_lwh_m == boxes.size_lwh_m[0]).all()


def test_without_registration_the_size_is_one_that_two_frames_show() -> None:
    velocity = np.tile([5.0, 0, 0], (4, 1))
    lengths_m = [4.0, 4.5, 5.0, 8.0]  # the last took something else along
    clouds = [wall((-length / 2, 5.1), (length / 2, 5.1)) for length in lengths_m]
    center = np.column_stack([1.0 * np.arange(4), np.full(4, 6.0), np.full(4, 1.0)])
    clouds = [cloud + [1.0 * number, 0, 0] for number, cloud in enumerate(clouds)]
    boxes = fit_amodal_boxes(seen(clouds, velocity_mps=velocity, center_m=center), UNREGISTERED).boxes
    assert boxes.size_lwh_m[0, 0] == pytest.approx(5.0, abs=0.11)
    np.testing.assert_allclose(boxes.size_lwh_m[:, 1], boxes.size_lwh_m[0, 1])
    # Its side is at y = 5.1 and faces the sensor at y = 0: the box lies beyond.
    np.testing.assert_allclose(boxes.center_m[:, 1], 5.1 + boxes.size_lwh_m[0, 1] / 2, atol=0.02)


def test_registered_frames_show_together_more_than_each_of_them() -> None:
    """The front half in some frames and the rear half in others, both with a mirror between them."""
    velocity = np.tile([5.0, 0, 0], (8, 1))
    whole = np.vstack([wall((-2.2, 5.1), (2.2, 5.1)), wall((0.0, 5.1), (0.0, 5.6), 0.4, 0.8)])
    clouds = [whole[whole[:, 0] < 1.6] if number % 2 else whole[whole[:, 0] > -1.6] for number in range(8)]
    center = np.column_stack([0.6 * np.arange(8), np.full(8, 6.0), np.full(8, 1.0)])
    clouds = [cloud + [0.6 * number, 0, 0] for number, cloud in enumerate(clouds)]
    sightings = seen(clouds, velocity_mps=velocity, center_m=center)
    boxes = fit_amodal_boxes(sightings, CONFIG).boxes
    assert boxes.size_lwh_m[0, 0] == pytest.approx(4.4, abs=0.15)
    np.testing.assert_allclose(boxes.center_m[:, 0] - center[:, 0], 0, atol=0.15)
    apart = fit_amodal_boxes(sightings, UNREGISTERED).boxes
    assert np.ptp(apart.center_m[:, 0] - center[:, 0]) > 0.3, "each half has a box of its own"
