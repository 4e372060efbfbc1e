"""Registration: move points by a known transform and ask for it back."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.geometry.se3 import apply
from upvl_cli.perception.registration.config import YawIcpConfig
from upvl_cli.perception.registration.icp import align_yaw, fit_yaw


def pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    matrix[:3, 3] = x_m, y_m, z_m
    return matrix


def car(count: int, seed: int) -> np.ndarray:
    """Points on two sides of a car of 4 m by 1.8 m by 1.5 m."""
    rng = np.random.default_rng(seed)
    along, up = rng.uniform(-2, 2, count), rng.uniform(0, 1.5, count)
    side = np.stack([along, np.full(count, -0.9), up], axis=1)
    rear = np.stack([np.full(count, -2.0), along * 0.45, up], axis=1)
    return np.concatenate([side, rear])


def test_a_fit_of_pairs_is_exact() -> None:
    points, truth = car(20, 0), pose(3, 4, 5, 2.5)
    np.testing.assert_allclose(fit_yaw(points, apply(truth, points)), truth, atol=1e-12)


@pytest.mark.parametrize(
    "truth",
    [pose(0, 0, 0, 0), pose(0.2, -0.1, 0.05, 0), pose(0.1, 0.1, 0, 0.1)],
    ids=["still", "shifted", "turned"],
)
def test_a_known_motion_comes_back(truth: np.ndarray) -> None:
    points = car(400, 1)
    found = align_yaw(
        points,
        apply(truth, points),
        np.eye(4),
        YawIcpConfig(radius_m=0.5, max_iterations=100, tolerance_m=1e-6),
    )
    np.testing.assert_allclose(found.target_from_source, truth, atol=1e-3)
    assert found.inlier_share == 1.0
    assert found.inlier_rmse_m < 1e-3


def test_other_points_of_the_same_thing_will_do() -> None:
    truth = pose(0.3, 0.1, 0, 0.05)
    found = align_yaw(
        car(400, 1),
        apply(truth, car(400, 2)),
        np.eye(4),
        YawIcpConfig(radius_m=0.5, max_iterations=100, tolerance_m=1e-6),
    )
    np.testing.assert_allclose(found.target_from_source, truth, atol=0.04)


@pytest.mark.parametrize(
    ("source", "target"),
    [(np.zeros((0, 3)), car(5, 0)), (car(5, 0), np.zeros((0, 3))), (car(5, 0), car(5, 0) + 99)],
    ids=["nothing to move", "nothing to reach", "nothing near"],
)
def test_the_start_is_kept_where_nothing_fits(source: np.ndarray, target: np.ndarray) -> None:
    start = pose(1, 2, 3, 0.4)
    found = align_yaw(source, target, start, YawIcpConfig(radius_m=1.0, max_iterations=5, tolerance_m=1e-3))
    np.testing.assert_array_equal(found.target_from_source, start)
    assert found.inlier_share == 0
    assert found.inlier_rmse_m == float("inf")
