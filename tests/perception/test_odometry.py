"""Odometry: a drive through a still scene with known poses, the same bytes every time, and real drives."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.perception.odometry.config import KissIcpConfig, PathSmoothingConfig
from upvl_cli.perception.odometry.lidar_odometry import estimate_poses
from upvl_cli.perception.odometry.smoothing import smooth_path

CONFIG = KissIcpConfig(
    voxel_m=1.0, min_range_m=1.0, max_range_m=100.0, warm_up_sweeps=4, initial_threshold_m=0.5
)


def smoothed(poses: np.ndarray, *, frame: np.ndarray, reach: int) -> np.ndarray:
    return smooth_path(poses, frame, PathSmoothingConfig("local-polynomial", reach, degree=2))


def scene() -> np.ndarray:
    """Ground, two walls, and pillars: enough to fix all six degrees of freedom."""
    rng = np.random.default_rng(0)
    ground = rng.uniform((-60, -10, -1.7), (60, 10, -1.7), (20000, 3))
    walls = rng.uniform((-60, -10, -1.7), (60, -10, 4), (10000, 3))
    walls[::2, 1] = 10
    pillars = [
        np.stack([x + 0.3 * np.cos(a), y + 0.3 * np.sin(a), z], axis=1)
        for x, y in zip(range(-55, 60, 7), np.tile([-7.0, 6.0, 8.0], 6), strict=False)
        for a, z in [(rng.uniform(0, 2 * np.pi, 300), rng.uniform(-1.7, 4, 300))]
    ]
    return np.concatenate([ground, walls, *pillars])


def pose(step: int) -> np.ndarray:
    """Forward at 1 m a sweep, in a gentle bend."""
    yaw = 0.01 * step
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:2, 3] = step, 0.005 * step**2
    return matrix


def sweeps(count: int) -> list[np.ndarray]:
    points = scene()
    return [(points - pose(step)[:3, 3]) @ pose(step)[:3, :3] for step in range(count)]


def test_known_poses_come_back() -> None:
    found = estimate_poses(sweeps(10), CONFIG)
    truth = np.array([pose(step) for step in range(10)])
    np.testing.assert_allclose(found[:, :3, 3], truth[:, :3, 3], atol=0.1)
    np.testing.assert_allclose(found[:, :3, :3], truth[:, :3, :3], atol=0.01)


def test_a_car_that_stands_stays() -> None:
    found = estimate_poses([scene()] * 4, CONFIG)
    np.testing.assert_allclose(found, np.broadcast_to(np.eye(4), (4, 4, 4)), atol=1e-3)


@pytest.mark.parametrize("count", [0, 1])
def test_short_drives(count: int) -> None:
    np.testing.assert_allclose(
        estimate_poses(sweeps(count), CONFIG), np.tile(np.eye(4), (count, 1, 1)), atol=1e-9
    )


def test_a_sweep_without_points_keeps_the_pose() -> None:
    found = estimate_poses([*sweeps(2), np.zeros((0, 3))], CONFIG)
    assert np.isfinite(found).all()


def test_the_same_bytes_every_time() -> None:
    drive = sweeps(6)
    assert estimate_poses(drive, CONFIG).tobytes() == estimate_poses(drive, CONFIG).tobytes()


def test_importing_it_loads_no_kiss_icp() -> None:
    code = "import sys, upvl_cli.perception.odometry.lidar_odometry; sys.exit('kiss_icp' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def path(count: int) -> np.ndarray:
    """Poses along a parabola: a car that brakes in a bend."""
    at = np.arange(count)
    poses = np.array([pose(step) for step in range(count)])
    poses[:, :3, 3] = np.stack([at - 0.01 * at**2, 0.005 * at**2, 0.0 * at], axis=1)
    return poses


def test_a_parabola_stays_what_it_is() -> None:
    kept = np.array([0, 1, 2, 4, 5, 6, 7, 9, 11, 12])  # numbers with gaps
    np.testing.assert_allclose(smoothed(path(13)[kept], frame=kept, reach=5), path(13)[kept], atol=1e-9)


def test_jitter_is_taken_off_and_rotations_stay() -> None:
    truth = path(40)
    jittery = truth.copy()
    jittery[:, :3, 3] += np.random.default_rng(0).normal(0, 0.03, (40, 3))
    found = smoothed(jittery, frame=np.arange(40), reach=5)
    assert (
        np.diff(found[:, 0, 3] - truth[:, 0, 3]).std()
        < 0.25 * np.diff(jittery[:, 0, 3] - truth[:, 0, 3]).std()
    )
    np.testing.assert_array_equal(found[:, :3, :3], truth[:, :3, :3])


@pytest.mark.parametrize(("count", "reach"), [(0, 5), (1, 5), (3, 5), (9, 0), (9, 1)])
def test_too_few_neighbours_change_nothing(count: int, reach: int) -> None:
    poses = path(count) if count else np.zeros((0, 4, 4))
    np.testing.assert_array_equal(smoothed(poses, frame=np.arange(count), reach=reach), poses)


@pytest.mark.real
@pytest.mark.slow
def test_real_sweeps_give_nearly_the_poses_of_the_drive(shared: Path) -> None:
    """34 m; the drive's own poses disagree with its sweeps by some 4 cm a step."""
    from upvl_cli.datasets.kitti.dataset import Kitti

    dataset = Kitti(shared / "data" / "kitti_raw_b")
    drive = dataset.open(dataset.segments[0])
    assert drive.world_from_ego is not None
    found = estimate_poses((drive.points(frame.index).xyz_ego_m for frame in drive.frames), CONFIG)
    given = np.linalg.inv(drive.world_from_ego[0]) @ drive.world_from_ego
    assert np.linalg.norm(given[-1, :3, 3] - found[-1, :3, 3]) < 0.01 * 34
