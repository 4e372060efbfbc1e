"""Boxes of a track correct each other."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.tracking import smoothing
from upvl_cli.perception.tracking.config import SmoothingConfig
from upvl_cli.perception.tracking.smoothing import smooth_tracks, weighted_median
from upvl_cli.types import Boxes

CONFIG = SmoothingConfig(enabled=True, window_s=0.3, min_weight_score=1e-3, unconfirmed_score_factor=0.5)
TIME_S = np.arange(20) / 10
TRUE = np.tile([0.0, 0.0, 0.9, 4.4, 1.8, 1.6, 0.025], (20, 1))
TRUE[:, :2] = TIME_S[:, None] * [12.0, 0.3]


def smoothed(
    rows: np.ndarray, score: np.ndarray, track_id: np.ndarray, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth boxes given as rows, and return them so."""
    boxes, sure = smooth_tracks(Boxes.from_rows(rows), score, track_id, time_s, CONFIG)
    return boxes.to_rows(), sure


def noisy(rng: np.random.Generator) -> np.ndarray:
    """A car on its way, each frame seen a bit wrong; its feet on the ground."""
    rows = TRUE + rng.normal(0, [0.4, 0.2, 0.0, 0.5, 0.2, 0.2, 0.1], (20, 7))
    rows[:, 2] = 0.1 + rows[:, 5] / 2
    return rows


def test_a_track_is_nearer_to_the_truth_than_its_boxes() -> None:
    rng = np.random.default_rng(1)
    rows = noisy(rng)
    found, score = smoothed(rows, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    before, after = np.abs(rows - TRUE).mean(axis=0), np.abs(found - TRUE).mean(axis=0)
    assert (after[[0, 1, 3, 4, 5, 6]] < 0.7 * before[[0, 1, 3, 4, 5, 6]]).all()
    assert np.ptp(found[:, 3:6], axis=0).max() == 0
    np.testing.assert_allclose(found[:, 2] - found[:, 5] / 2, 0.1, atol=1e-6)
    np.testing.assert_allclose(score, 0.6)


def test_what_is_right_stays_and_order_does_not_matter() -> None:
    found, _ = smoothed(TRUE, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    np.testing.assert_allclose(found, TRUE, atol=1e-6)
    mixed = np.random.default_rng(2).permutation(20)
    rows = noisy(np.random.default_rng(3))
    straight, _ = smoothed(rows, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    turned, _ = smoothed(rows[mixed], np.full(20, 0.6), np.zeros(20, int), TIME_S[mixed])
    np.testing.assert_allclose(turned, straight[mixed], atol=1e-6)


def test_one_box_that_looks_backwards_is_turned_round() -> None:
    rows = TRUE.copy()
    rows[7, 6] += np.pi
    rows[8, 6] -= 0.4
    found, _ = smoothed(rows, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    assert np.abs(found[:, 6] - 0.025).max() < 0.1


def test_a_turn_is_not_cut_off() -> None:
    heading = 0.6 * TIME_S  # a quarter of a turn in 2.6 s, as at a crossing
    rows = TRUE.copy()
    rows[:, 6] = heading
    rows[:, 0], rows[:, 1] = 8 * np.sin(heading), 8 * (1 - np.cos(heading))
    found, _ = smoothed(rows, np.full(20, 0.6), np.zeros(20, int), TIME_S)
    assert np.hypot(*(found - rows)[1:-1, :2].T).max() < 0.15
    assert np.abs(found - rows)[:, 6].max() < 0.6 * CONFIG.window_s


def test_scores_of_a_track_meet_and_a_box_alone_counts_half() -> None:
    score = np.array([0.9, 0.1, 0.8, 0.4])
    rows = np.tile(TRUE[0], (4, 1))
    track = np.array([5, 5, -1, 9])
    found, said = smoothed(rows, score, track, np.array([0.0, 0.1, 0.0, 0.3]))
    np.testing.assert_allclose(
        said, [np.sqrt(0.45), np.sqrt(0.05), 0.8 * CONFIG.unconfirmed_score_factor, 0.4]
    )
    np.testing.assert_allclose(found, rows, atol=1e-6)
    assert score[2] == 0.8  # what was given is left as it was


@pytest.mark.parametrize("scores", [[], [0.0, 0.0, 0.0]])
def test_nothing_and_scores_of_zero(scores: list[float]) -> None:
    rows = TRUE[: len(scores)]
    found, said = smoothed(rows, np.array(scores), np.zeros(len(scores), int), TIME_S[: len(scores)])
    np.testing.assert_allclose(found, rows, atol=1e-6)
    assert said.tolist() == scores


def test_the_weighted_median_is_where_half_of_the_weight_is_reached() -> None:
    values = np.array([3.0, 1.0, 2.0])
    assert weighted_median(values, np.array([1.0, 1.0, 1.0])) == 2
    assert weighted_median(values, np.array([2.1, 1.0, 1.0])) == 3
    assert weighted_median(values, np.array([1.0, 2.0, 1.0])) == 1, "with exactly half, the lower one"
    assert weighted_median(values, np.array([1.0, 1.0, 1.5])) == 2


def test_the_size_of_a_track_is_that_of_its_surest_box() -> None:
    rows = np.tile(TRUE[0], (4, 1))
    rows[:, 3] = [4.0, 4.4, 4.8, 5.2]
    # Squared scores are 0.81 and 0.09, 0.16, 0.16: the first box alone has more than half of the weight.
    found, _ = smoothed(rows, np.array([0.9, 0.3, 0.4, 0.4]), np.zeros(4, int), TIME_S[:4])
    np.testing.assert_array_equal(found[:, 3], 4.0)


def test_the_lower_side_of_a_box_stays_where_it_was_when_its_height_changes() -> None:
    rows = np.tile(TRUE[0], (3, 1))
    rows[:, 5], rows[:, 2] = [1.0, 1.6, 1.8], [0.5, 0.8, 0.9]  # all stand on 0
    found, _ = smoothed(rows, np.ones(3), np.zeros(3, int), TIME_S[:3])
    np.testing.assert_array_equal(found[:, 5], 1.6)
    np.testing.assert_allclose(found[:, 2], 0.8, atol=1e-9)


def test_centers_lie_on_the_line_of_weighted_least_squares_through_those_around_them() -> None:
    rng = np.random.default_rng(5)
    rows = TRUE[:9].copy()
    rows[:, :2] += rng.normal(0, 0.5, (9, 2))
    score, time_s = rng.uniform(0.2, 1, 9), np.sort(rng.uniform(0, 1, 9))
    found, _ = smoothed(rows, score, np.zeros(9, int), time_s)
    for row, now_s in enumerate(time_s):
        # polyfit squares its weights: the score, and the root of a Gaussian of 0.3 s.
        weight = score * np.exp(-(((time_s - now_s) / 0.3) ** 2) / 4)
        for axis in (0, 1):
            line = np.polyfit(time_s - now_s, rows[:, axis], 1, w=weight)
            assert found[row, axis] == pytest.approx(line[1], abs=1e-6)


def test_the_mean_heading_is_of_the_axes_and_the_surer_end_is_ahead() -> None:
    rows = np.tile(TRUE[0], (4, 1))
    rows[:, 6] = [0.1, 0.3, 0.2 + np.pi, 0.2 + np.pi]  # two ways along one axis
    at_once = np.zeros(4)
    found, _ = smoothed(rows, np.array([0.8, 0.8, 0.4, 0.4]), np.zeros(4, int), at_once)
    np.testing.assert_allclose(found[:, 6], 0.2, atol=1e-6)
    found, _ = smoothed(rows, np.array([0.4, 0.4, 0.8, 0.8]), np.zeros(4, int), at_once)
    np.testing.assert_allclose(found[:, 6], 0.2 - np.pi, atol=1e-6)


def test_a_heading_follows_the_boxes_near_in_time() -> None:
    rows = np.tile(TRUE[0], (6, 1))
    rows[:, 6] = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    found, _ = smoothed(rows, np.ones(6), np.zeros(6, int), np.array([0.0, 0.1, 0.2, 5.0, 5.1, 5.2]))
    np.testing.assert_allclose(found[:, 6], rows[:, 6], atol=1e-6)


def test_a_track_does_not_correct_another() -> None:
    rows = np.tile(TRUE[0], (4, 1))
    rows[2:, :2], rows[2:, 3] = [30.0, 30.0], 8.0
    found, _ = smoothed(rows, np.ones(4), np.array([0, 0, 1, 1]), np.array([0.0, 0.1, 0.0, 0.1]))
    np.testing.assert_allclose(found, rows, atol=1e-6)


def test_boxes_in_no_track_are_no_track_together() -> None:
    rows = np.tile(TRUE[0], (2, 1))
    rows[1, :2], rows[1, 3] = [9.0, 9.0], 6.0
    found, sure = smoothed(rows, np.array([0.8, 0.4]), np.array([-1, -1]), np.array([0.0, 0.1]))
    np.testing.assert_array_equal(found, rows)
    np.testing.assert_allclose(sure, [0.4, 0.2])


def test_a_long_track_is_smoothed_block_by_block_as_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plain way weighs all boxes of the track for each of them; a minute is many times the reach of the weight."""
    rng = np.random.default_rng(2)
    rows = np.tile(TRUE, (30, 1)) + rng.normal(0, 0.1, (600, 7))
    time_s = np.arange(600) / 10 + (np.arange(600) > 300) * 20.0  # with a gap
    arguments = rows, rng.uniform(0.1, 1, 600), np.zeros(600, int), time_s
    monkeypatch.setattr(smoothing, "_BLOCK", 600)
    whole, whole_score = smoothed(*arguments)
    monkeypatch.setattr(smoothing, "_BLOCK", 50)
    blocks, score = smoothed(*arguments)
    np.testing.assert_allclose(blocks, whole, atol=1e-9)
    np.testing.assert_array_equal(score, whole_score)
