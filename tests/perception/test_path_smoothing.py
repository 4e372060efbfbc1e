"""Smoothing of a path: which neighbors take part, and what a local polynomial keeps."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.odometry.config import PathSmoothingConfig
from upvl_cli.perception.odometry.smoothing import smooth_path

CONFIG = PathSmoothingConfig("local-polynomial", half_window_s=0.35, degree=2)


def path(x_m: np.ndarray) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(x_m), 1, 1))
    poses[:, 0, 3] = x_m
    return poses


def smoothed(
    x_m: np.ndarray,
    time_s: np.ndarray | None = None,
    config: PathSmoothingConfig = CONFIG,
    is_placed: np.ndarray | None = None,
) -> np.ndarray:
    time_s = np.arange(len(x_m)) / 10 if time_s is None else time_s
    is_placed = np.ones(len(x_m), dtype=bool) if is_placed is None else is_placed
    return smooth_path(path(x_m), time_s, is_placed, config)[:, 0, 3]


@pytest.mark.parametrize(("degree", "is_kept"), [(1, False), (2, True), (3, True)])
def test_a_parabola_is_kept_from_degree_two_on(degree: int, is_kept: bool) -> None:
    parabola = 0.1 * np.arange(12.0) ** 2
    found = smoothed(parabola, config=PathSmoothingConfig("local-polynomial", 0.35, degree))
    assert np.allclose(found, parabola, atol=1e-9) == is_kept


def test_a_cubic_is_not_kept() -> None:
    cubic = np.arange(12.0) ** 3
    assert np.abs(smoothed(cubic) - cubic)[[0, -1]].min() > 0.1


def test_neighbors_count_by_their_time_up_to_the_half_window() -> None:
    """A jump moves the estimates of frames at most 0.35 s away, however many sweeps lie between."""
    time_s = np.array([0, 1, 2, 3, 5, 6, 7, 8, 9, 10]) / 10
    jump = np.zeros(10)
    jump[4] = 1.0  # at 0.5 s
    moved = time_s[smoothed(jump, time_s) != 0]
    assert moved.tolist() == [0.2, 0.3, 0.5, 0.6, 0.7, 0.8]


@pytest.mark.parametrize(("rate_hz", "frames"), [(10, 3), (20, 7), (2, 0)])
def test_a_window_of_time_holds_more_frames_at_a_higher_rate(rate_hz: int, frames: int) -> None:
    jump = np.zeros(8 * rate_hz)
    jump[4 * rate_hz] = 1.0
    moved = np.flatnonzero(smoothed(jump, np.arange(len(jump)) / rate_hz) != 0)
    assert moved.min() == 4 * rate_hz - frames
    assert moved.max() == 4 * rate_hz + frames


def test_each_position_is_the_value_of_its_own_least_squares_parabola() -> None:
    rng = np.random.default_rng(0)
    time_s = np.array([3, 4, 6, 7, 8, 9, 12, 13, 14, 15]) / 10
    x_m = rng.normal(0, 1, 10)
    found = smoothed(x_m, time_s)
    for step in range(10):
        near = np.abs(time_s - time_s[step]) <= 0.35
        parabola = np.polyfit(time_s[near], x_m[near], 2)
        assert found[step] == pytest.approx(np.polyval(parabola, time_s[step]), abs=1e-9)


def test_what_was_not_placed_decides_on_nothing_and_lies_on_the_parabola_of_the_others() -> None:
    x_m = 0.1 * np.arange(12.0) ** 2
    wrong = x_m.copy()
    wrong[6] += 5.0
    found = smoothed(wrong, is_placed=np.arange(12) != 6)
    np.testing.assert_allclose(found, x_m, atol=1e-9)


def test_a_car_that_stands_stands_exactly() -> None:
    np.testing.assert_array_equal(smoothed(np.zeros(30)), 0)


def test_four_neighbors_are_enough_for_a_parabola_and_three_change_nothing() -> None:
    """Three points lie on a parabola whatever they are."""
    assert smoothed(np.array([0.0, 1, 0, 1]))[0] != 0
    np.testing.assert_array_equal(smoothed(np.array([0.0, 1, 0])), [0, 1, 0])


def test_the_method_none_changes_nothing() -> None:
    x_m = np.random.default_rng(0).normal(0, 1, 10)
    np.testing.assert_array_equal(smoothed(x_m, config=PathSmoothingConfig("none", 0.35, 2)), x_m)


def test_the_given_poses_are_not_written_to() -> None:
    poses = path(np.array([0.0, 1, 0, 1, 0, 1]))
    before = poses.copy()
    smooth_path(poses, np.arange(6) / 10, np.ones(6, dtype=bool), CONFIG)
    np.testing.assert_array_equal(poses, before)
