"""Rigid transforms: there and back, and angles at the seam."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.se3 import apply, from_yaw, inverse, rotate, wrap_angle, yaw_of


def random_pose(seed: int) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    pose[:3, 3] = [3.0, -40.0, 1e5]
    return pose


def test_a_quarter_turn_takes_x_to_y_and_adds_the_translation() -> None:
    moved = apply(from_yaw(math.pi / 2, [10, 20, 30]), [[1, 0, 0], [0, 1, 2]])
    np.testing.assert_allclose(moved, [[10, 21, 30], [9, 20, 32]], atol=1e-12)


def test_the_inverse_brings_points_back() -> None:
    poses = np.stack([random_pose(i) for i in range(5)])
    np.testing.assert_allclose(inverse(poses) @ poses, np.tile(np.eye(4), (5, 1, 1)), atol=1e-10)
    xyz = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)
    there = apply(poses[0], xyz)
    np.testing.assert_allclose(apply(inverse(poses[0]), there), xyz, atol=1e-9)


def test_a_batch_equals_one_at_a_time() -> None:
    yaw, place = np.array([0.1, -2.0, 3.0]), np.arange(9.0).reshape(3, 3)
    xyz = np.random.default_rng(0).normal(size=(3, 6, 3))
    moved = apply(from_yaw(yaw, place), xyz)
    for i in range(3):
        np.testing.assert_array_equal(moved[i], apply(from_yaw(yaw[i], place[i]), xyz[i]))
    np.testing.assert_allclose(yaw_of(from_yaw(yaw, place)), yaw, atol=1e-15)


def test_yaw_of_a_tilted_pose_is_the_heading_of_its_x_axis() -> None:
    tilted = np.eye(4)
    tilted[:3, :3] = Rotation.from_euler("ZY", [0.7, 0.2]).as_matrix()
    assert yaw_of(tilted) == pytest.approx(0.7)


ANGLES = [
    (0.0, 0.0),
    (math.pi, -math.pi),
    (-math.pi, -math.pi),
    (3 * math.pi, -math.pi),
    (math.nextafter(math.pi, 0), math.nextafter(math.pi, 0)),
    (7.0, 7.0 - 2 * math.pi),
    (-7.0, 2 * math.pi - 7.0),
]


@pytest.mark.parametrize(("angle", "expected"), ANGLES)
def test_wrap_angle(angle: float, expected: float) -> None:
    assert wrap_angle(angle) == pytest.approx(expected, abs=1e-12)


@given(st.floats(-1e9, 1e9))
def test_wrapped_angles_lie_in_range_and_point_the_same_way(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1, abs=1e-6)


def test_empty() -> None:
    assert apply(np.eye(4), np.zeros((0, 3))).shape == (0, 3)
    assert inverse(np.zeros((0, 4, 4))).shape == (0, 4, 4)
    assert from_yaw(np.zeros(0), np.zeros((0, 3))).shape == (0, 4, 4)
    assert wrap_angle([]).shape == (0,)
    assert yaw_of(np.zeros((0, 4, 4))).shape == (0,)


@pytest.mark.parametrize("n", [1, 999, 1000, 1500])
def test_few_and_many_vectors_are_rotated_to_the_same_bits(n: int) -> None:
    rng = np.random.default_rng(n)
    poses, vectors = from_yaw(rng.uniform(-3, 3, 2), rng.normal(size=(2, 3))), rng.normal(size=(2, n, 3)) * 50
    expected = [
        [[(v[0] * m[r, 0] + v[1] * m[r, 1]) + v[2] * m[r, 2] for r in range(3)] for v in some]
        for m, some in zip(poses, vectors, strict=True)
    ]
    np.testing.assert_array_equal(rotate(poses, vectors), expected)
