"""What moves is at least as fast as the threshold."""

from __future__ import annotations

import numpy as np

from upvl_cli.algorithms.masks import UNKNOWN, Background, moving, without_feature
from upvl_cli.algorithms.open_vocabulary import Basis
from upvl_cli.algorithms.views import NO_VIEW, OCCLUDED, SEEN


def test_the_threshold_itself_moves() -> None:
    velocity = np.array([[1.0, 0, 0], [0.75, 0.75, 0], [0.99, 0, 0], [0, 0, -3], [0, 0, 0]], np.float16)
    np.testing.assert_array_equal(moving(velocity, min_speed_mps=1.0), [True, True, False, True, False])


def test_a_threshold_of_zero_takes_every_point() -> None:
    assert moving(np.zeros((3, 3), np.float16), min_speed_mps=0.0).all()


def test_empty() -> None:
    assert moving(np.zeros((0, 3), np.float16), min_speed_mps=1.0).shape == (0,)


BASIS = Basis(np.zeros(3), np.vstack([np.eye(3), np.zeros((61, 3))]), np.full(64, 0.01), 1.0)
ROAD, TREE, CAR = np.eye(3)
STATE = np.array([SEEN, OCCLUDED, SEEN, NO_VIEW, SEEN])


def kept(*directions: np.ndarray) -> np.ndarray:
    return BASIS.rounded(BASIS.kept(np.array(directions)))


def test_a_seen_point_is_background_where_its_best_word_reaches_the_threshold() -> None:
    rule = Background(BASIS, np.array([ROAD, TREE]), np.zeros((0, 3)), 0.6)
    feature = kept(ROAD, CAR, TREE + 0.9 * CAR)  # cosines 1, 0 and 0.743
    assert rule.of(STATE, feature).tolist() == [1, UNKNOWN, 0, UNKNOWN, 1]


def test_background_is_compared_with_the_other_words_where_there_are_some() -> None:
    rule = Background(BASIS, np.array([ROAD, TREE]), np.array([CAR]), 0.2)
    assert rule.of(STATE, kept(ROAD, CAR, TREE + 0.9 * CAR)).tolist() == [1, UNKNOWN, 0, UNKNOWN, 0]


def test_the_policy_for_points_without_a_feature() -> None:
    seen, fast = np.array([1, 0, UNKNOWN, UNKNOWN], np.int8), np.array([False, False, True, False])
    assert without_feature(seen, fast, policy="keep").tolist() == [1, 0, UNKNOWN, UNKNOWN]
    assert without_feature(seen, fast, policy="drop").tolist() == [1, 0, 1, 1]
    assert without_feature(seen, fast, policy="moving").tolist() == [1, 0, UNKNOWN, 1]
