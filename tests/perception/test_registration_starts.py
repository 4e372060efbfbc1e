"""Registration from several starts: the guesses, the grid about the first, and which result is accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from upvl_cli.geometry.se3 import apply, from_yaw
from upvl_cli.perception.registration.config import RegistrationConfig, YawIcpConfig
from upvl_cli.perception.registration.icp import Alignment, align_yaw, register_clouds

CONFIG = RegistrationConfig(
    radius_m=0.2,
    max_iterations=30,
    tolerance_m=1e-4,
    start_offsets=(-0.5, -0.25, 0.0, 0.25, 0.5),
    sufficient_inlier_share=0.8,
    min_inlier_share=0.5,
    max_yaw_rad=0.3,
)
EXTENT_M = np.array([4.0, 2.0])


def corner(count: int = 400, seed: int = 0) -> np.ndarray:
    """Side and rear of a car of 4 m by 2 m, with a mirror that fixes its place along the side."""
    rng = np.random.default_rng(seed)
    along, up = rng.uniform(-2, 2, count), rng.uniform(0, 1.5, count)
    side = np.stack([along, np.full(count, -1.0), up], axis=1)
    rear = np.stack([np.full(count, -2.0), along * 0.5, up], axis=1)
    mirror = rng.uniform((0.8, -1.3, 0.9), (1.0, -1.0, 1.1), (40, 3))
    return np.concatenate([side, rear, mirror])


def shift(x_m: float, y_m: float, yaw_rad: float = 0.0) -> np.ndarray:
    return from_yaw(yaw_rad, np.array([x_m, y_m, 0.0]))


def register(truth: np.ndarray, config: RegistrationConfig, *guesses: np.ndarray) -> Alignment | None:
    points = corner()
    return register_clouds(points, apply(truth, points), guesses or (np.eye(4),), EXTENT_M, config)


@pytest.mark.parametrize(
    "offset", [(-0.5, 0.0), (0.25, -0.5), (0.5, 0.5), (0.0, 0.5), (-0.25, 0.25)], ids=str
)
def test_the_grid_finds_what_lies_beyond_the_radius(offset: tuple[float, float]) -> None:
    """Shares of the length along x and of the width along y: the start lies within 5 cm of the truth."""
    truth = shift(offset[0] * 4.0 + 0.04, offset[1] * 2.0 - 0.03)
    found = register(truth, CONFIG)
    assert found is not None
    np.testing.assert_allclose(found.target_from_source, truth, atol=0.01)
    without_grid = register(truth, replace(CONFIG, start_offsets=(0.0,)))
    assert without_grid is None or np.abs(without_grid.target_from_source - truth).max() > 0.1


def test_the_grid_is_laid_about_the_first_guess() -> None:
    truth = shift(10 + 2.0, 5 + 0.5)
    found = register(truth, CONFIG, shift(10, 5), np.eye(4))
    assert found is not None
    np.testing.assert_allclose(found.target_from_source, truth, atol=0.01)


def test_the_grid_is_scaled_by_the_given_extent() -> None:
    points = corner()
    truth = shift(3.0, 0.0)
    for length_m, is_found in ((6.0, True), (4.0, False)):
        found = register_clouds(points, apply(truth, points), (np.eye(4),), np.array([length_m, 2.0]), CONFIG)
        assert (found is not None and np.allclose(found.target_from_source, truth, atol=0.01)) == is_found


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("limit_rad", "is_accepted"), [(0.3, False), (0.4, True)])
def test_a_large_turn_is_rejected(sign: int, limit_rad: float, is_accepted: bool) -> None:
    truth = shift(0, 0, sign * 0.35)
    found = register(truth, replace(CONFIG, max_yaw_rad=limit_rad), truth)
    assert (found is not None) == is_accepted


@pytest.mark.parametrize(("share", "is_accepted"), [(0.7, False), (0.5, True)])
def test_too_few_inliers_are_rejected(share: float, is_accepted: bool) -> None:
    """Of the source 60 % has a partner, the rest lies far off."""
    target = corner()
    source = np.concatenate([target[::2], target[: len(target) // 3] + (50, 0, 0)])
    found = register_clouds(source, target, (np.eye(4),), EXTENT_M, replace(CONFIG, min_inlier_share=share))
    assert (found is not None) == is_accepted


def test_all_guesses_are_tried_before_one_suffices() -> None:
    """The first guess has all points within the radius; the second one fits exactly."""
    points = corner()
    cold = replace(CONFIG, max_iterations=1, radius_m=1.0)
    found = register_clouds(points, points, (shift(0.1, 0.1, 0.02), np.eye(4)), EXTENT_M, cold)
    assert found is not None
    assert found.inlier_rmse_m < 1e-9
    found = register_clouds(points, points, (np.eye(4), shift(0.1, 0.1, 0.02)), EXTENT_M, cold)
    assert found is not None
    assert found.inlier_rmse_m < 1e-9


def test_the_grid_is_left_out_where_a_guess_suffices() -> None:
    """Half a length off, 85 % of a regular row fits as well; only with a higher demand the grid is asked."""
    x = np.repeat(np.arange(20.0), 10)
    row = np.stack([x, np.tile(np.linspace(0, 1, 10), 20), 0 * x], axis=1)
    truth, extent = shift(3.0, 0.0), np.array([6.0, 0.0])
    lazy = register_clouds(row, apply(truth, row), (np.eye(4),), extent, CONFIG)
    assert lazy is not None and lazy.inlier_share == pytest.approx(0.85)
    thorough = replace(CONFIG, sufficient_inlier_share=0.9)
    found = register_clouds(row, apply(truth, row), (np.eye(4),), extent, thorough)
    assert found is not None
    np.testing.assert_allclose(found.target_from_source, truth, atol=1e-9)


def test_a_point_without_partner_costs_as_one_at_the_radius() -> None:
    few_exact = Alignment(np.eye(4), inlier_rmse_m=0.0, inlier_share=0.5)
    all_near = Alignment(np.eye(4), inlier_rmse_m=0.1, inlier_share=1.0)
    assert few_exact.error_m2(0.2) == pytest.approx(0.5 * 0.04)
    assert all_near.error_m2(0.2) == pytest.approx(0.01)
    assert Alignment(np.eye(4), 0.1, 0.75).error_m2(0.2) == pytest.approx(0.75 * 0.01 + 0.25 * 0.04)
    assert Alignment(np.eye(4), float("inf"), 0.0).error_m2(0.2) == pytest.approx(0.04)


def test_the_error_counts_inliers_alone() -> None:
    target = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    source = target + np.array([[0, 0, 0.3], [0, 0, 0.3], [0, 0, 0.4], [0, 9, 0]])
    found = align_yaw(source, target, np.eye(4), YawIcpConfig(0.5, max_iterations=0, tolerance_m=1e-3))
    assert found.inlier_share == 0.75
    assert found.inlier_rmse_m == pytest.approx(np.sqrt((0.09 + 0.09 + 0.16) / 3))


def test_iterations_are_limited() -> None:
    points = corner()
    target = apply(shift(0.3, 0.2, 0.1), points)
    errors = [
        align_yaw(points, target, np.eye(4), YawIcpConfig(1.0, steps, 1e-6)).inlier_rmse_m
        for steps in (0, 1, 5, 200)
    ]
    assert errors == sorted(errors, reverse=True) and len(set(errors)) == 4
    assert errors[-1] < 1e-3


def test_steps_below_the_tolerance_end_it() -> None:
    points = corner()
    target = apply(shift(0.3, 0.2), points)
    one_step = align_yaw(points, target, np.eye(4), YawIcpConfig(1.0, 1, 1e-9))
    coarse = align_yaw(points, target, np.eye(4), YawIcpConfig(1.0, 100, 0.9))
    np.testing.assert_array_equal(coarse.target_from_source, one_step.target_from_source)


@pytest.mark.parametrize(("count", "moves"), [(2, False), (3, True)])
def test_a_step_needs_three_pairs(count: int, moves: bool) -> None:
    points = corner()[:count] * (10, 1, 1)
    found = align_yaw(points, points + (0.1, 0, 0), np.eye(4), YawIcpConfig(0.2, 10, 1e-3))
    assert (np.abs(found.target_from_source - np.eye(4)).max() > 0.05) == moves
