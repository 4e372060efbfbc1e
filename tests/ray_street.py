"""A straight street without a car in it, as LiDARs of any beams see it: the truth of the tests of sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.config.toml import load
from upvl_cli.perception.drive_check.sample import DriveSample, spread_runs
from upvl_cli.types import Frame, Points, concat

CONFIG = load(CheckConfig, Path(__file__).parents[1] / "stages" / "check.toml")
STEP_NS = 100_000_000
SPEED_MPS = 8.0
REACH_M = 90.0
WALL_M, WALL_HEIGHT_M = 8.0, 4.0  # to each side


@dataclass(frozen=True)
class Lidar:
    """A LiDAR that turns: where it sits above the road, its beams, its columns."""

    origin_m: tuple[float, float, float] = (0.0, 0.0, 1.8)
    beams_deg: tuple[float, ...] = tuple(np.linspace(-24, 4, 32))
    columns: int = 900
    field_deg: float = 360.0
    sense: int = -1  # clockwise
    by_beam: bool = False  # in the file, instead of column by column
    sensor: int = 0

    def sweep(self, x_m: float, seed: int) -> Points:
        """Return what it sees from a car at x of the street, in axes on the road below the car."""
        azimuth = self.sense * np.linspace(
            -self.field_deg / 2, self.field_deg / 2, self.columns, endpoint=False
        )
        order = "xy" if self.by_beam else "ij"
        azimuth_deg, beam = np.meshgrid(azimuth, self.beams_deg, indexing=order)
        a, e = np.radians(azimuth_deg.ravel()), np.radians(beam.ravel())
        time_ns = (
            np.meshgrid(np.linspace(-0.5, 0.5, self.columns), self.beams_deg, indexing=order)[0].ravel()
            * STEP_NS
        )
        ray = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        range_m = _ranges(np.array(self.origin_m), ray, x_m)
        rng = np.random.default_rng(seed)
        hit = range_m < REACH_M
        total = int(hit.sum())
        xyz = np.array(self.origin_m) + ray[hit] * (range_m[hit] + rng.normal(0, 0.01, total))[:, None]
        return Points(
            xyz, rng.uniform(0.01, 0.99, total), np.zeros(total), np.full(total, self.sensor), time_ns[hit]
        )


def _ranges(origin_m: np.ndarray, ray: np.ndarray, x_m: float) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        found = [np.where(ray[:, 2] < 0, -origin_m[2] / ray[:, 2], np.inf)]
        for side in (-WALL_M, WALL_M):
            found.append(_bounded((side - origin_m[1]) / ray[:, 1], origin_m, ray))
            for place in np.arange(-60, 200, 13.0) - x_m + 3 * (side > 0):  # steps of the walls, 2 m deep
                across = (place - origin_m[0]) / ray[:, 0]
                y = np.abs(origin_m[1] + across * ray[:, 1])
                near = (
                    (np.sign(origin_m[1] + across * ray[:, 1]) == np.sign(side))
                    & (y > WALL_M - 2)
                    & (y < WALL_M)
                )
                found.append(np.where(near, _bounded(across, origin_m, ray), np.inf))
    return np.min(found, axis=0)


def _bounded(range_m: np.ndarray, origin_m: np.ndarray, ray: np.ndarray) -> np.ndarray:
    z = origin_m[2] + range_m * ray[:, 2]
    return np.where((range_m > 0.5) & (z > 0) & (z < WALL_HEIGHT_M), range_m, np.inf)


def drive_sample(
    lidars: Sequence[Lidar] = (Lidar(),),
    change: Callable[[Points, int], Points] = lambda points, step: points,
    *,
    frames: int = 16,
    axes_z_m: float = 0.0,
    speed_mps: float = SPEED_MPS,
) -> DriveSample:
    """Return a drive along the street; its ego axes are `axes_z_m` above the road, and `change` spoils its sweeps."""

    def sweep(step: int) -> Points:
        x_m = step * STEP_NS * 1e-9 * speed_mps
        points = concat([lidar.sweep(x_m, 10 * step + lidar.sensor) for lidar in lidars], Points)
        return change(replace(points, xyz_ego_m=points.xyz_ego_m - [0, 0, axes_z_m]), step)

    cached: dict[int, Points] = {}
    return DriveSample(
        frames=tuple(Frame(number, number * STEP_NS) for number in range(frames)),
        world_from_ego=None,
        ground_z_m=-axes_z_m,
        cameras=(),
        runs=spread_runs(frames, 4, 2),
        sweep=lambda step: cached[step] if step in cached else cached.setdefault(step, sweep(step)),
        picture=lambda step, camera: None,
    )


def with_times(sample: DriveSample, time_ns: Sequence[int]) -> DriveSample:
    """Return the drive with other times of its frames."""
    return replace(sample, frames=tuple(Frame(number, int(time)) for number, time in enumerate(time_ns)))
