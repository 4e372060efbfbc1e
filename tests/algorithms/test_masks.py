"""What moves is at least as fast as the threshold."""

from __future__ import annotations

import numpy as np

from upvl_cli.algorithms.masks import UNKNOWN, moving, unknown_background


def test_the_threshold_itself_moves() -> None:
    velocity = np.array([[1.0, 0, 0], [0.75, 0.75, 0], [0.99, 0, 0], [0, 0, -3], [0, 0, 0]], np.float16)
    np.testing.assert_array_equal(moving(velocity, min_speed_mps=1.0), [True, True, False, True, False])


def test_a_threshold_of_zero_takes_every_point() -> None:
    assert moving(np.zeros((3, 3), np.float16), min_speed_mps=0.0).all()


def test_empty() -> None:
    assert moving(np.zeros((0, 3), np.float16), min_speed_mps=1.0).shape == (0,)


def test_without_features_the_background_is_unknown() -> None:
    assert unknown_background(2).tolist() == [UNKNOWN, UNKNOWN]
