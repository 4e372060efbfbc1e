"""Boxes of a track correct each other."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.tracking.refinement import SMOOTH_S, UNCONFIRMED, refined

TIME_S = np.arange(20) / 10
TRUE = np.tile([0.0, 0.0, 0.9, 4.4, 1.8, 1.6, 0.025], (20, 1))
TRUE[:, :2] = TIME_S[:, None] * [12.0, 0.3]


def noisy(rng: np.random.Generator) -> np.ndarray:
    """A car on its way, each frame seen a bit wrong; its feet on the ground."""
    seven = TRUE + rng.normal(0, [0.4, 0.2, 0.0, 0.5, 0.2, 0.2, 0.1], (20, 7))
    seven[:, 2] = 0.1 + seven[:, 5] / 2
    return seven


def test_a_track_is_nearer_to_the_truth_than_its_boxes() -> None:
    rng = np.random.default_rng(1)
    seven = noisy(rng)
    found, score = refined(seven, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    before, after = np.abs(seven - TRUE).mean(axis=0), np.abs(found - TRUE).mean(axis=0)
    assert (after[[0, 1, 3, 4, 5, 6]] < 0.7 * before[[0, 1, 3, 4, 5, 6]]).all()
    assert np.ptp(found[:, 3:6], axis=0).max() == 0
    np.testing.assert_allclose(found[:, 2] - found[:, 5] / 2, 0.1, atol=1e-6)
    np.testing.assert_allclose(score, 0.6)


def test_what_is_right_stays_and_order_does_not_matter() -> None:
    found, _ = refined(TRUE, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    np.testing.assert_allclose(found, TRUE, atol=1e-6)
    mixed = np.random.default_rng(2).permutation(20)
    seven = noisy(np.random.default_rng(3))
    straight, _ = refined(seven, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    turned, _ = refined(seven[mixed], np.full(20, 0.6), np.zeros(20, int), TIME_S[mixed])
    np.testing.assert_allclose(turned, straight[mixed], atol=1e-6)


def test_one_box_that_looks_backwards_is_turned_round() -> None:
    seven = TRUE.copy()
    seven[7, 6] += np.pi
    seven[8, 6] -= 0.4
    found, _ = refined(seven, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    assert np.abs(found[:, 6] - 0.025).max() < 0.1


def test_a_turn_is_not_cut_off() -> None:
    heading = 0.6 * TIME_S  # a quarter of a turn in 2.6 s, as at a crossing
    seven = TRUE.copy()
    seven[:, 6] = heading
    seven[:, 0], seven[:, 1] = 8 * np.sin(heading), 8 * (1 - np.cos(heading))
    found, _ = refined(seven, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    assert np.hypot(*(found - seven)[1:-1, :2].T).max() < 0.15
    assert np.abs(found - seven)[:, 6].max() < 0.6 * SMOOTH_S


def test_scores_of_a_track_meet_and_a_box_alone_counts_half() -> None:
    score = np.array([0.9, 0.1, 0.8, 0.4])
    seven = np.tile(TRUE[0], (4, 1))
    track = np.array([5, 5, -1, 9])
    found, said = refined(seven, score, track, np.array([0.0, 0.1, 0.0, 0.3]))
    np.testing.assert_allclose(said, [np.sqrt(0.45), np.sqrt(0.05), 0.8 * UNCONFIRMED, 0.4])
    np.testing.assert_allclose(found, seven, atol=1e-6)
    assert score[2] == 0.8  # what was given is left as it was


@pytest.mark.parametrize("scores", [[], [0.0, 0.0, 0.0]])
def test_nothing_and_scores_of_zero(scores: list[float]) -> None:
    seven = TRUE[: len(scores)]
    found, said = refined(seven, np.array(scores), np.zeros(len(scores), int), TIME_S[: len(scores)])
    np.testing.assert_allclose(found, seven, atol=1e-6)
    assert said.tolist() == scores
