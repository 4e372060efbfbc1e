"""Odometry: drives through a still scene with known poses at any speed and rate, and real drives."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.still_scene import (
    LIDAR,
    UNSMOOTHED,
    drive,
    estimated,
    gentle_bend,
    points_at,
    prepared,
    truth,
)
from upvl_cli.perception.odometry.lidar_odometry import estimate_trajectory

TENTHS_S = np.arange(6) / 10


@pytest.mark.parametrize(
    ("speed_mps", "times_s"),
    [
        (10.0, TENTHS_S),
        (30.0, TENTHS_S),  # 3 m a step from the first one on
        (-15.0, TENTHS_S),  # backwards
        (12.0, np.arange(5) / 2),  # 2 Hz: 6 m a step
        (20.0, np.array([0, 0.1, 0.2, 0.4, 0.5, 0.8])),  # frames are missing
    ],
    ids=["10 m/s", "30 m/s", "backwards", "2 Hz", "gaps"],
)
def test_known_poses_come_back(speed_mps: float, times_s: np.ndarray) -> None:
    found = estimated(gentle_bend(speed_mps), times_s)
    expected = truth(gentle_bend(speed_mps), times_s)
    np.testing.assert_allclose(found.world_from_ego[:, :3, 3], expected[:, :3, 3], atol=0.15)
    np.testing.assert_allclose(found.world_from_ego[:, :3, :3], expected[:, :3, :3], atol=0.01)
    assert found.is_placed.all()


def test_axes_that_are_turned_change_nothing_but_the_axes() -> None:
    """Y forward: the motion is searched in all directions."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = gentle_bend(25.0)
    sweeps = [prepared(points_at(pose(time_s)) @ turn.T, time_s) for time_s in TENTHS_S.tolist()]
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED)
    expected = truth(pose, TENTHS_S)[:, :3, 3] @ turn.T
    np.testing.assert_allclose(found.world_from_ego[:, :3, 3], expected, atol=0.15)


def test_a_gap_of_one_and_a_half_seconds_is_bridged() -> None:
    times_s = np.array([0, 0.1, 0.2, 0.3, 0.4, 1.9, 2.0])
    found = estimated(gentle_bend(10.0), times_s)
    np.testing.assert_allclose(
        found.world_from_ego[:, :3, 3], truth(gentle_bend(10.0), times_s)[:, :3, 3], atol=0.15
    )
    assert found.is_placed.all()
    np.testing.assert_array_equal(np.flatnonzero(found.is_bridged), [5])


def test_a_frame_that_fits_nowhere_is_interpolated_and_uncertain() -> None:
    """A sweep of another place, and one without points."""
    pose = gentle_bend(10.0)
    sweeps = list(drive(pose, np.arange(8) / 10))
    rng = np.random.default_rng(1)
    sweeps[4] = prepared(rng.uniform((-50, -50, -2), (50, 50, 4), (20000, 3)), 0.4)
    sweeps[6] = prepared(np.zeros((0, 3)), 0.6)
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED)
    np.testing.assert_array_equal(np.flatnonzero(~found.is_placed), [4, 6])
    np.testing.assert_allclose(
        found.world_from_ego[:, :3, 3], truth(pose, np.arange(8) / 10)[:, :3, 3], atol=0.1
    )
    assert np.isnan(found.residual_m[[4, 6]]).all()
    assert (found.position_sigma_m[[4, 6]] > 5 * found.position_sigma_m[5]).all()


def test_a_sweep_that_is_repeated_while_the_car_drives_is_not_placed() -> None:
    """No car stops within a tenth of a second."""
    sweeps = list(drive(gentle_bend(15.0), np.arange(7) / 10))
    sweeps[4] = replace(sweeps[3], time_s=0.4)
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED)
    np.testing.assert_array_equal(np.flatnonzero(~found.is_placed), [4])
    np.testing.assert_allclose(
        found.world_from_ego[:, 0, 3], truth(gentle_bend(15.0), np.arange(7) / 10)[:, 0, 3], atol=0.1
    )


def test_after_a_long_silence_the_path_starts_anew_and_says_so() -> None:
    times_s = np.array([0, 0.1, 0.2, 0.3, 2.0, 3.5, 5.0, 5.1, 5.2])
    sweeps = list(drive(gentle_bend(6.0), times_s))
    for number in (4, 5):
        sweeps[number] = prepared(np.zeros((0, 3)), float(times_s[number]))
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED)
    np.testing.assert_array_equal(np.flatnonzero(~found.is_placed), [4, 5])
    assert found.position_sigma_m[6] > 10  # nothing but the predicted motion leads to it
    steps = np.diff(found.world_from_ego[:, 0, 3])
    np.testing.assert_allclose(steps[-2:], 0.6, atol=0.1)


def test_sweeps_are_compensated_for_the_motion_during_them() -> None:
    """Points of a turn of 0.1 s at 20 m/s: uncompensated they are up to a metre off."""
    pose, sweeps = gentle_bend(20.0, 0.3), []
    for number, time_s in enumerate(TENTHS_S.tolist()):
        at_once = points_at(pose(time_s), number)
        offset_s = -np.arctan2(at_once[:, 1], at_once[:, 0]) / (2 * np.pi) * 0.1
        measured = np.empty_like(at_once)
        for share in range(-10, 10):
            part = (offset_s >= share * 0.005) & (offset_s <= (share + 1) * 0.005)
            moved = np.linalg.inv(pose(time_s + (share + 0.5) * 0.005)) @ pose(time_s)
            measured[part] = at_once[part] @ moved[:3, :3].T + moved[:3, 3]
        sweeps.append(prepared(measured, time_s, offset_s))
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED)
    np.testing.assert_allclose(found.world_from_ego[:, :3, 3], truth(pose, TENTHS_S)[:, :3, 3], atol=0.15)
    blind = [replace(sweep, **without_times(sweep)) for sweep in sweeps]
    assert np.nanmean(estimate_trajectory(blind, LIDAR, UNSMOOTHED).residual_m) > np.nanmean(found.residual_m)


def without_times(sweep: object) -> dict[str, object]:
    return {
        name: replace(getattr(sweep, name), offset_s=np.zeros(len(getattr(sweep, name))))
        for name in ("map_points", "source", "structure")
    }


def test_a_car_that_stands_stays() -> None:
    """Alignment ends at steps below 2 mm; from then on nothing moves."""
    sweeps = [prepared(points_at(np.eye(4)), time_s) for time_s in TENTHS_S.tolist()]
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED).world_from_ego
    np.testing.assert_allclose(found, np.broadcast_to(np.eye(4), found.shape), atol=2e-3)
    assert np.abs(np.diff(found[1:, :3, 3], axis=0)).max() < 1e-4


@pytest.mark.parametrize("count", [0, 1])
def test_short_drives(count: int) -> None:
    found = estimated(gentle_bend(10.0), TENTHS_S[:count])
    np.testing.assert_allclose(found.world_from_ego, np.tile(np.eye(4), (count, 1, 1)), atol=1e-9)
    assert found.is_placed.all()


def test_a_drive_without_points_has_no_placed_frame() -> None:
    found = estimate_trajectory([prepared(np.zeros((0, 3)), t) for t in (0.0, 0.1)], LIDAR, UNSMOOTHED)
    assert not found.is_placed.any()
    assert np.isfinite(found.world_from_ego).all()


def test_without_anything_upright_nothing_is_judged() -> None:
    rng = np.random.default_rng(0)
    road = rng.uniform((-50, -20, -1.7), (50, 20, -1.69), (5000, 3))
    found = estimate_trajectory([prepared(road, t) for t in (0.0, 0.1, 0.2)], LIDAR, UNSMOOTHED)
    np.testing.assert_allclose(found.world_from_ego[-1], np.eye(4), atol=1e-3)
    assert np.isnan(found.residual_m).all()
    assert np.isinf(found.position_sigma_m[1:]).all()


def test_the_same_bytes_every_time() -> None:
    first, second = (estimated(gentle_bend(20.0), TENTHS_S[:4]) for _ in range(2))
    assert first.world_from_ego.tobytes() == second.world_from_ego.tobytes()


def test_importing_it_loads_no_kiss_icp() -> None:
    code = "import sys, upvl_cli.perception.odometry.lidar_odometry; sys.exit('kiss_icp' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("ring_m", [2.0, 120.0], ids=["near", "far"])
def test_points_out_of_range_do_not_count(ring_m: float) -> None:
    """A ring that goes with the car: the car's own body, or something far off. Not a byte changes."""
    angle, z = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 6.28, 100), np.linspace(0, 1, 10)))
    ring = np.stack([ring_m * np.cos(angle), ring_m * np.sin(angle), z], axis=1)
    sweeps = [points_at(gentle_bend(10.0)(time_s)) for time_s in (0.0, 0.1)]
    kept = [sweep[np.linalg.norm(sweep, axis=1) > 3.5] for sweep in sweeps]

    def poses(clouds: list[np.ndarray]) -> bytes:
        prepared_ = [prepared(cloud, number / 10) for number, cloud in enumerate(clouds)]
        return estimate_trajectory(prepared_, LIDAR, UNSMOOTHED).world_from_ego.tobytes()

    assert poses([np.concatenate([cloud, ring]) for cloud in kept]) == poses(kept)


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.parametrize("step", [1, 2, 3])
def test_real_sweeps_give_nearly_the_poses_of_the_drive(shared: Path, step: int) -> None:
    """34 m, with each sweep, each second and each third: 0.8 to 2.3 m a step."""
    from upvl_cli.datasets.kitti.dataset import Kitti

    dataset = Kitti(shared / "data" / "kitti_raw_b")
    drive_b = dataset.open(dataset.segments[0])
    assert drive_b.world_from_ego is not None
    sweeps = []
    for frame in drive_b.frames[::step]:
        points = drive_b.measured_points(frame.index)
        assert points is not None
        time_s = (frame.time_ns - drive_b.frames[0].time_ns) / 1e9
        sweeps.append(prepared(points.xyz_ego_m, time_s, points.time_offset_ns / 1e9))
    found = estimate_trajectory(sweeps, LIDAR, UNSMOOTHED).world_from_ego
    given = np.linalg.inv(drive_b.world_from_ego[0]) @ drive_b.world_from_ego[::step]
    assert np.linalg.norm(given[-1, :3, 3] - found[-1, :3, 3]) < 0.01 * 34
