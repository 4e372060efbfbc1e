"""Motion at constant velocity: logarithm and exponential undo each other, and time scales them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.odometry.constant_velocity import (
    compensate_motion,
    motion_over,
    velocity_between,
)

TWIST = np.array([12.0, -0.5, 0.1, 0.02, -0.03, 0.6])


@pytest.mark.parametrize("scale", [1.0, 0.0, 1e-10])
def test_the_exponential_is_that_of_the_matrix(scale: float) -> None:
    x, y, z = scale * TWIST[3:] * 0.7
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = TWIST[:3] * 0.7
    found = motion_over(np.concatenate([TWIST[:3], scale * TWIST[3:]]), 0.7)
    np.testing.assert_allclose(found, expm(generator), atol=1e-9)


def test_the_logarithm_gives_the_velocity_back_from_any_pose() -> None:
    start = motion_over(np.array([3.0, 2, 1, 0.1, 0.2, 2.0]), 1.0)
    end = compose(start, motion_over(TWIST, 0.4))
    np.testing.assert_allclose(velocity_between(start, end, 0.4), TWIST, atol=1e-9)


def test_places_are_moved_to_where_the_car_stood() -> None:
    rng = np.random.default_rng(0)
    still, offset_s = rng.uniform(-40, 40, (200, 3)), rng.uniform(-0.05, 0.05, 200)
    measured = np.array(
        [
            (inverse(motion_over(TWIST, time_s)) @ np.append(place, 1))[:3]
            for place, time_s in zip(still, offset_s.tolist(), strict=True)
        ]
    )
    np.testing.assert_allclose(compensate_motion(measured, offset_s, TWIST), still, atol=1e-3)
