"""Poses from latitude, longitude and attitude."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.datasets.kitti.oxts import OxtsRecord, world_from_ego, world_from_imu


def test_attitude_is_yaw_then_pitch_then_roll() -> None:
    angles = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    records = np.column_stack([np.full((50, 3), 1.0), angles])
    poses = world_from_imu(records, first_latitude_deg=1.0)
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    np.testing.assert_allclose(poses[:, :3, :3], expected, atol=1e-12)


def test_a_ten_thousandth_of_a_degree_is_its_length_on_the_ground() -> None:
    step_deg = 1e-4
    step_m = np.deg2rad(step_deg) * 6378137
    records = np.zeros((3, 6))
    records[:, :3] = [[49, 8, 100], [49 + step_deg, 8, 100], [49, 8 + step_deg, 103]]
    place = world_from_imu(records, first_latitude_deg=49.0)[:, :3, 3]
    np.testing.assert_allclose(place[1] - place[0], [0, step_m, 0], atol=1e-4)  # 11.13 m to the north
    np.testing.assert_allclose(place[2] - place[0], [step_m * np.cos(np.deg2rad(49)), 0, 3], atol=1e-4)


def test_the_first_record_of_the_drive_sets_the_scale() -> None:
    places = [(10.0, 8.0), (60.0, 8.0), (60.0, 8.0001)]
    records = [OxtsRecord(" ".join(map(str, [*place, *[0] * 28])), "a line") for place in places]
    poses = world_from_ego(records[0], records[1:], np.eye(4))
    east_m = np.deg2rad(1e-4) * 6378137 * np.cos(np.deg2rad(10.0))
    np.testing.assert_allclose(poses[:, :3, 3], [[0, 0, 0], [east_m, 0, 0]], atol=1e-6)


def test_nothing_gives_nothing() -> None:
    assert world_from_imu(np.empty((0, 6)), first_latitude_deg=49.0).shape == (0, 4, 4)
