"""A car on a slope, under several LiDARs at two heights: the ground stays ground, and the car stands on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.ground.height import height_above_ground
from upvl_cli.stages.ground import GroundConfig

CONFIG = load(GroundConfig, Path(__file__).parents[2] / "stages" / "ground.toml")
BEAMS_DEG = {
    "64 beams": np.linspace(-24.8, 2, 64),
    "40 beams": np.linspace(-25, 15, 40),
    "32 beams": np.linspace(-30.7, 10.7, 32),
    "16 beams": np.linspace(-15, 15, 16),
}
CAR_M = (15.0, 3.0)


def sweep(beams_deg: np.ndarray, slope: float, height_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of an even slope and of a car on it, with 2 cm of noise, and which of them are the car's."""
    azimuth, elevation = np.meshgrid(np.deg2rad(np.arange(0, 360, 0.4)), np.deg2rad(beams_deg))
    level = np.cos(elevation)
    ray = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    ray = ray.reshape(-1, 3)
    road_z_m = slope * CAR_M[0] - height_m
    low = np.array([CAR_M[0] - 2.2, CAR_M[1] - 0.9, road_z_m + 0.25])
    high = np.array([CAR_M[0] + 2.2, CAR_M[1] + 0.9, road_z_m + 1.5])
    with np.errstate(divide="ignore", invalid="ignore"):
        ground_m = -height_m / (ray @ np.array([-slope, 0.0, 1.0]))
        ends = np.sort(np.stack([low / ray, high / ray]), axis=0)
    enter, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    car_m = np.where((enter < leave) & (enter > 0), enter, np.inf)
    range_m = np.minimum(np.where(ground_m > 0, ground_m, np.inf), car_m)
    seen = range_m < 60
    noise = np.random.default_rng(0).normal(0, 0.02, seen.sum())
    return ray[seen] * (range_m[seen] + noise)[:, None], (car_m < ground_m)[seen]


@pytest.mark.parametrize("slope", [0.0, -0.05, 0.1, 0.15])
@pytest.mark.parametrize("height_m", [1.7, 2.4])
@pytest.mark.parametrize("name", BEAMS_DEG)
def test_the_road_of_a_slope_is_ground_and_what_stands_on_it_is_not(
    name: str, height_m: float, slope: float
) -> None:
    xyz_m, is_car = sweep(BEAMS_DEG[name], slope, height_m)
    found_m = height_above_ground(xyz_m, -height_m, CONFIG.map)
    true_m = xyz_m[:, 2] - (slope * xyz_m[:, 0] - height_m)
    near = np.hypot(xyz_m[:, 0], xyz_m[:, 1]) < 30
    assert (found_m[~is_car & near] > CONFIG.max_height_m).mean() < 0.002
    if is_car.any():  # a steep slope lifts it above the highest beam
        assert abs(np.median((found_m - true_m)[is_car])) < 0.05
        assert (found_m[is_car & (true_m > 0.4)] > CONFIG.max_height_m).all()
