"""A still scene, the sweeps of a car that drives through it, and the settings of odometry for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.geometry.se3 import from_yaw
from upvl_cli.perception.odometry.lidar_odometry import estimate_trajectory
from upvl_cli.perception.odometry.sweep import PreparedSweep, prepare_sweep
from upvl_cli.perception.odometry.trajectory import EstimatedPath
from upvl_cli.stages.odometry import OdometryConfig

SETTINGS = load(OdometryConfig, Path(__file__).parents[2] / "stages" / "odometry.toml")
LIDAR = SETTINGS.lidar
UNSMOOTHED = replace(SETTINGS.smoothing, method="none")
HALF_M = 60.0


def scene() -> np.ndarray:
    """Ground, two walls with bays, and pillars that stand nowhere evenly: enough to fix all six degrees of freedom."""
    rng = np.random.default_rng(0)
    ground = rng.uniform((-90, -12, -1.7), (150, 12, -1.7), (16000, 3))
    walls = rng.uniform((-90, -12, -1.7), (150, -12, 4), (16000, 3))
    walls[::2, 1] = 12
    bay = np.floor(walls[:, 0] / 5).astype(int) * 7 % 11 % 3
    walls[:, 1] -= np.sign(walls[:, 1]) * bay
    pillars = [
        np.stack([x + 0.3 * np.cos(a), y + 0.3 * np.sin(a), z], axis=1)
        for x, y in zip(rng.uniform(-90, 150, 50), rng.choice([-6.0, -4.0, 5.0, 7.0], 50), strict=True)
        for a, z in [(rng.uniform(0, 2 * np.pi, 120), rng.uniform(-1.7, 4, 120))]
    ]
    return np.concatenate([ground, walls, *pillars])


SCENE = scene()


def gentle_bend(speed_mps: float, turn_radps: float = 0.1) -> Callable[[float], np.ndarray]:
    """Pose by time of a car on a circle."""

    def pose(time_s: float) -> np.ndarray:
        yaw, radius_m = turn_radps * time_s, speed_mps / turn_radps
        return from_yaw(yaw, np.array([radius_m * np.sin(yaw), radius_m * (1 - np.cos(yaw)), 0.0]))

    return pose


def points_at(pose: np.ndarray, seed: int = 0) -> np.ndarray:
    """Nine tenths of what lies near, in ego axes: each sweep hits other places of the same surfaces."""
    seen = SCENE[np.random.default_rng(seed).random(len(SCENE)) < 0.9]
    xyz = (seen - pose[:3, 3]) @ pose[:3, :3]
    return np.asarray(xyz[np.abs(xyz[:, 0]) < HALF_M])


def prepared(xyz_m: np.ndarray, time_s: float, offset_s: np.ndarray | None = None) -> PreparedSweep:
    """The sweep as odometry takes it."""
    offset_s = np.zeros(len(xyz_m)) if offset_s is None else offset_s
    return prepare_sweep(xyz_m, offset_s, time_s, LIDAR.kiss_icp, LIDAR.structure)


def drive(pose: Callable[[float], np.ndarray], times_s: np.ndarray) -> Iterator[PreparedSweep]:
    """The sweeps at those times."""
    for number, time_s in enumerate(np.asarray(times_s).tolist()):
        yield prepared(points_at(pose(time_s), number), time_s)


def estimated(pose: Callable[[float], np.ndarray], times_s: np.ndarray) -> EstimatedPath:
    """What odometry makes of them."""
    return estimate_trajectory(drive(pose, times_s), LIDAR, UNSMOOTHED)


def truth(pose: Callable[[float], np.ndarray], times_s: np.ndarray) -> np.ndarray:
    """(T, 4, 4) poses in the axes of the first."""
    poses = np.array([pose(time_s) for time_s in np.asarray(times_s).tolist()])
    return np.asarray(np.linalg.inv(poses[0]) @ poses)
