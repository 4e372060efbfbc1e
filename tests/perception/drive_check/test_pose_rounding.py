"""Rounded positions are told from smooth ones by their steps alone."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.drive_check.pose_rounding import rounding_m
from upvl_cli.types import Array


def path(speed_mps: Array, heading_rad: float = 0.4) -> Array:
    """Poses at 10 Hz of a car that drives straight on."""
    distance_m = np.cumsum(speed_mps) * 0.1
    poses = np.tile(np.eye(4), (len(speed_mps), 1, 1))
    poses[:, 0, 3], poses[:, 1, 3] = distance_m * np.cos(heading_rad), distance_m * np.sin(heading_rad)
    return poses


DRIVING = path(np.linspace(9.0, 7.0, 60))


@pytest.mark.parametrize("grid_m", [1.11, 0.5, 0.1])
def test_a_grid_is_found(grid_m: float) -> None:
    rounded = DRIVING.copy()
    rounded[:, :2, 3] = np.round(rounded[:, :2, 3] / grid_m) * grid_m
    rounded[:, :2, 3] += np.random.default_rng(0).normal(
        0, 0.0005, (60, 2)
    )  # a lever arm on a car that sways
    assert rounding_m(rounded) == pytest.approx(grid_m, rel=0.03)


@pytest.mark.parametrize(
    "poses",
    [
        DRIVING,
        path(np.full(60, 8.0)),  # steps of one length, and none of nothing
        path(np.r_[np.zeros(20), np.linspace(0, 8, 20), np.full(20, 8.0)]),
        path(np.zeros(60)),
        path(np.full(2, 8.0)),
        DRIVING + np.random.default_rng(1).normal(0, 0.02, (60, 4, 4)) * [[0, 0, 0, 1]] * 1.0,
    ],
)
def test_no_grid_is_made_up(poses: Array) -> None:
    assert rounding_m(poses) == 0
