"""What moves is at least as fast as the threshold."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.background.masks import (
    UNKNOWN,
    BackgroundClassifier,
    apply_motion_and_policy,
    moving,
)
from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.perception.visual.views import NO_VIEW, OCCLUDED, SEEN


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
    return BASIS.quantize(BASIS.project(np.array(directions)))


def test_a_seen_point_is_background_where_its_best_word_reaches_the_threshold() -> None:
    rule = BackgroundClassifier(BASIS, np.array([ROAD, TREE]), np.zeros((0, 3)), 0.6)
    feature = kept(ROAD, CAR, TREE + 0.9 * CAR)  # cosines 1, 0 and 0.743
    assert rule.classify(STATE, feature).tolist() == [1, UNKNOWN, 0, UNKNOWN, 1]


def test_background_is_compared_with_the_other_words_where_there_are_some() -> None:
    rule = BackgroundClassifier(BASIS, np.array([ROAD, TREE]), np.array([CAR]), 0.2)
    assert rule.classify(STATE, kept(ROAD, CAR, TREE + 0.9 * CAR)).tolist() == [1, UNKNOWN, 0, UNKNOWN, 0]


def applied(state: np.ndarray, fast: np.ndarray, policy: str, foreground: bool = True) -> list[int]:
    found = apply_motion_and_policy(state, fast, policy=policy, moving_is_foreground=foreground)
    assert isinstance(found, np.ndarray)
    return [int(value) for value in found]


def test_the_policy_for_points_without_a_feature() -> None:
    seen, fast = np.array([1, 0, UNKNOWN, UNKNOWN], np.int8), np.array([False, False, True, False])
    assert applied(seen, fast, "keep") == [1, 0, UNKNOWN, UNKNOWN]
    assert applied(seen, fast, "drop") == [1, 0, 1, 1]
    assert applied(seen, fast, "moving") == [1, 0, UNKNOWN, 1]


def test_what_moves_is_no_background_whatever_words_say() -> None:
    seen, fast = np.array([1, 1, 0, UNKNOWN]), np.array([True, False, True, True])
    assert applied(seen, fast, "keep") == [UNKNOWN, 1, 0, UNKNOWN]


def test_words_keep_what_moves_where_the_rule_is_off() -> None:
    seen, fast = np.array([1, 1, 0, UNKNOWN]), np.array([True, False, True, True])
    assert applied(seen, fast, "keep", foreground=False) == [1, 1, 0, UNKNOWN]
    assert applied(seen, fast, "moving", foreground=False) == [1, 1, 0, UNKNOWN]


def test_the_score_is_the_best_background_word_less_the_best_other() -> None:
    rule = BackgroundClassifier(BASIS, np.array([ROAD, TREE]), np.array([CAR]), 0.0)
    found = rule.score(kept(ROAD, TREE + CAR, CAR))
    np.testing.assert_allclose(found, [1, 0, -1], atol=0.02)


def test_a_score_at_the_threshold_is_background() -> None:
    plain = BackgroundClassifier(BASIS, np.array([ROAD]), np.zeros((0, 3)), 0.0)
    exact = float(plain.score(kept(ROAD + 0.3 * CAR))[0])
    for threshold, state in ((exact, 1), (np.nextafter(np.float32(exact), np.float32(2)), 0)):
        rule = BackgroundClassifier(BASIS, np.array([ROAD]), np.zeros((0, 3)), threshold)
        assert rule.classify(np.array([SEEN]), kept(ROAD + 0.3 * CAR)).tolist() == [state]
