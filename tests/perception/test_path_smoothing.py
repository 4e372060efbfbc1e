"""Smoothing of a path: which neighbors take part, and what a local polynomial keeps."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.odometry.config import PathSmoothingConfig
from upvl_cli.perception.odometry.smoothing import smooth_path

CONFIG = PathSmoothingConfig("local-polynomial", half_window_frames=3, degree=2)


def path(x_m: np.ndarray) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(x_m), 1, 1))
    poses[:, 0, 3] = x_m
    return poses


def smoothed(
    x_m: np.ndarray, frame: np.ndarray | None = None, config: PathSmoothingConfig = CONFIG
) -> np.ndarray:
    frame = np.arange(len(x_m)) if frame is None else frame
    return smooth_path(path(x_m), frame, config)[:, 0, 3]


@pytest.mark.parametrize(("degree", "is_kept"), [(1, False), (2, True), (3, True)])
def test_a_parabola_is_kept_from_degree_two_on(degree: int, is_kept: bool) -> None:
    parabola = 0.1 * np.arange(12.0) ** 2
    found = smoothed(parabola, config=PathSmoothingConfig("local-polynomial", 3, degree))
    assert np.allclose(found, parabola, atol=1e-9) == is_kept


def test_a_cubic_is_not_kept() -> None:
    cubic = np.arange(12.0) ** 3
    assert np.abs(smoothed(cubic) - cubic)[[0, -1]].min() > 0.1


def test_neighbors_count_by_their_frame_up_to_the_half_window() -> None:
    """A jump moves the estimates of frames at most three away, however many sweeps lie between."""
    frame = np.array([0, 1, 2, 3, 5, 6, 7, 8, 9, 10])
    jump = np.zeros(10)
    jump[4] = 1.0  # at frame 5
    moved = frame[smoothed(jump, frame) != 0]
    assert moved.tolist() == [2, 3, 5, 6, 7, 8]


def test_each_position_is_the_value_of_its_own_least_squares_parabola() -> None:
    rng = np.random.default_rng(0)
    frame = np.array([3, 4, 6, 7, 8, 9, 12, 13, 14, 15])
    x_m = rng.normal(0, 1, 10)
    found = smoothed(x_m, frame)
    for step in range(10):
        near = np.abs(frame - frame[step]) <= 3
        parabola = np.polyfit(frame[near], x_m[near], 2)
        assert found[step] == pytest.approx(np.polyval(parabola, frame[step]), abs=1e-9)


def test_four_neighbors_are_enough_for_a_parabola_and_three_change_nothing() -> None:
    """Three points lie on a parabola whatever they are."""
    assert smoothed(np.array([0.0, 1, 0, 1]))[0] != 0
    np.testing.assert_array_equal(smoothed(np.array([0.0, 1, 0])), [0, 1, 0])


def test_the_method_none_changes_nothing() -> None:
    x_m = np.random.default_rng(0).normal(0, 1, 10)
    np.testing.assert_array_equal(smoothed(x_m, config=PathSmoothingConfig("none", 3, 2)), x_m)


def test_the_given_poses_are_not_written_to() -> None:
    poses = path(np.array([0.0, 1, 0, 1, 0, 1]))
    before = poses.copy()
    smooth_path(poses, np.arange(6), CONFIG)
    np.testing.assert_array_equal(poses, before)
