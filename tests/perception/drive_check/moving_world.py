"""A street of walls, poles and a road, seen by a turning LiDAR from a moving car: poses are known exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from upvl_cli.commands.check_config import CheckConfig
from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.perception.drive_check.motion_config import MotionCheckConfig
from upvl_cli.perception.drive_check.sample import DriveSample, spread_runs
from upvl_cli.types import Array, Frame, Points

TOML = Path(__file__).parents[3] / "stages" / "check.toml"
RATE_HZ = 10
FRAMES = 24
HEIGHT_M = 1.8


@cache
def config() -> MotionCheckConfig:
    """Return the settings that ship."""
    return load(CheckConfig, TOML).motion


@cache
def street() -> Array:
    """Return (n, 3) points of a street along x: road, two uneven rows of houses, poles."""
    rng = np.random.default_rng(0)
    road = rng.uniform((-60, -9, 0), (110, 9, 0.02), (12000, 3))
    parts = [road]
    for side in (-1, 1):
        x = -60.0
        while x < 110:
            width, setback = rng.uniform(5, 12), rng.uniform(9, 13)
            front = rng.uniform((x, setback, 0), (x + width, setback + 0.01, 6), (int(90 * width), 3))
            flank = rng.uniform((x, setback, 0), (x + 0.01, setback + 4, 6), (250, 3))
            parts += [part * (1, side, 1) for part in (front, flank)]
            x += width + rng.uniform(0.5, 3)
    for x in np.arange(-58, 108, 7.3):
        angle, z = rng.uniform(0, 2 * np.pi, 120), rng.uniform(0, 5, 120)
        y = rng.choice([-7.5, -6.5, 6.5, 7.5])
        parts.append(np.column_stack([x + 0.15 * np.cos(angle), y + 0.15 * np.sin(angle), z]))
    return np.concatenate(parts)


def path(frames: int = FRAMES, *, speed_mps: float = 10.0, braking_mps2: float = 1.5) -> Array:
    """Return (T, 4, 4) poses of the LiDAR of a car that brakes and weaves; its turn changes, its path is smooth."""
    fine_s = np.arange(0, frames / RATE_HZ, 0.001)
    speed = np.maximum(speed_mps - braking_mps2 * fine_s, 0.0)
    heading = 0.9 + 0.08 * np.sin(2.0 * fine_s) - 0.08 * fine_s if speed_mps else 0.9 + 0 * fine_s
    xy = np.cumsum(
        np.column_stack([np.cos(heading - 0.9), np.sin(heading - 0.9)]) * speed[:, None] * 0.001, axis=0
    )
    xy = xy @ np.array([[np.cos(0.9), np.sin(0.9)], [-np.sin(0.9), np.cos(0.9)]])
    at = (np.arange(frames) * 1000) // RATE_HZ
    return from_yaw(heading[at], np.column_stack([xy[at], np.full(frames, HEIGHT_M)]))


def sample(
    world_from_ego: Array,
    *,
    claimed: Array | None = None,
    change: Callable[[Points, int], Points] | None = None,
    runs: int = 5,
    length: int = 4,
) -> DriveSample:
    """Return a sample of a drive through the street along given poses.

    Args:
        world_from_ego: Where the car is.
        claimed: Where the drive says that it is; the same where nothing is given.
        change: Changes the points of a step.
        runs: Moments.
        length: Sweeps of each.
    """
    frames = tuple(Frame(step, step * 10**9 // RATE_HZ) for step in range(len(world_from_ego)))

    @cache
    def sweep(step: int) -> Points:
        rng = np.random.default_rng([1, step])
        street_from_world = from_yaw(-0.9, np.zeros(3))
        local = apply(inverse(world_from_ego[step]), apply(inverse(street_from_world), street()))
        local = local[(np.hypot(local[:, 0], local[:, 1]) < 50) & (rng.random(len(local)) < 0.7)]
        local = local + rng.normal(0, 0.015, local.shape)
        total = len(local)
        offset_ns = -np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) * 1e9 / RATE_HZ
        points = Points(local, np.zeros(total), np.zeros(total), np.zeros(total), offset_ns)
        return change(points, step) if change else points

    return DriveSample(
        frames=frames,
        world_from_ego=world_from_ego if claimed is None else claimed,
        ground_z_m=-HEIGHT_M,
        cameras=(),
        runs=spread_runs(len(frames), runs, length),
        sweep=sweep,
        picture=lambda step, camera: None,
    )


def turned(matrix: Array) -> Callable[[Points, int], Points]:
    """Return a change of the axes or the unit of points."""
    return lambda points, _: replace(points, xyz_ego_m=points.xyz_ego_m @ np.asarray(matrix, np.float32).T)
