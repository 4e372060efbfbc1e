"""Votes of points, against a plain loop and by hand."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from upvl_cli.query.votes import NO_CLASS, best_of_groups, vote

CLASS_OF_WORD = np.array([0, 0, 1, 2, 2])


def plain_vote(
    cosines: np.ndarray, box_of_point: np.ndarray, boxes: int
) -> list[tuple[int, int, float, float]]:
    """The same, point by point."""
    result = []
    for box in range(boxes):
        points = cosines[box_of_point == box]
        if not len(points):
            result.append((NO_CLASS, NO_CLASS, 0.0, 0.0))
            continue
        choice = points.argmax(axis=1)
        words = Counter(choice.tolist())
        kinds = Counter(CLASS_OF_WORD[choice].tolist())
        mean = {
            k: np.mean([p.max() for p, c in zip(points, choice, strict=True) if CLASS_OF_WORD[c] == k])
            for k in kinds
        }
        kind = max(kinds, key=lambda k: (kinds[k], mean[k]))
        word = max((w for w in range(5) if CLASS_OF_WORD[w] == kind), key=lambda w: words[w])
        result.append((kind, word, kinds[kind] / len(points), float(mean[kind])))
    return result


def test_votes_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    box_of_point = rng.integers(0, 60, 200)  # few points a box: ties, and boxes without points
    cosines = rng.normal(size=(200, 5))
    result = vote(cosines, box_of_point, 61, CLASS_OF_WORD)
    expected = plain_vote(cosines, box_of_point, 61)
    assert NO_CLASS in result.class_index
    np.testing.assert_array_equal(result.class_index, [one[0] for one in expected])
    np.testing.assert_array_equal(result.word_index, [one[1] for one in expected])
    np.testing.assert_allclose(result.share, [one[2] for one in expected])
    np.testing.assert_allclose(result.cosine, [one[3] for one in expected], atol=1e-12)


def test_words_of_a_kind_vote_together() -> None:
    """Two votes for each word of kind 0 beat three for kind 1."""
    choice = [0, 0, 1, 1, 2, 2, 2]
    result = vote(np.eye(5)[choice], np.zeros(7, int), 1, CLASS_OF_WORD)
    assert (result.class_index[0], result.word_index[0]) == (0, 0)
    assert result.share[0] == pytest.approx(4 / 7)


def test_of_equal_votes_the_nearer_kind_wins() -> None:
    cosines = np.array(
        [[0.5, 0, 0.4, 0, 0], [0.1, 0, 0.6, 0, 0]]
    )  # one vote each; kind 1 is nearer on average
    result = vote(cosines, np.zeros(2, int), 1, CLASS_OF_WORD)
    assert result.class_index[0] == 1
    assert result.cosine[0] == pytest.approx(0.6)


def test_without_points_nothing_wins() -> None:
    result = vote(np.zeros((0, 5)), np.zeros(0, int), 2, CLASS_OF_WORD)
    assert result.class_index.tolist() == [NO_CLASS, NO_CLASS]
    assert not result.share.any()
    assert len(vote(np.zeros((0, 5)), np.zeros(0, int), 0, CLASS_OF_WORD).share) == 0


def test_the_best_of_each_track_comes_first() -> None:
    score, track = np.array([0.1, 0.9, 0.8, 0.9, 0.5, 0.4]), np.array([1, 2, 2, -1, -1, 1])
    assert best_of_groups(score, track, 9).tolist() == [1, 3, 4, 5]
    assert best_of_groups(score, track, 2).tolist() == [1, 3]
    assert best_of_groups(score[:0], track[:0], 2).tolist() == []


def test_the_best_of_many_tracks_is_that_of_a_full_sort() -> None:
    rng = np.random.default_rng(0)
    score, track = (
        rng.integers(0, 400, 5000) / 400,
        np.sort(rng.integers(-1, 9, 5000)),
    )  # many equals, few tracks
    order = np.argsort(-score, kind="stable")
    kept: dict[tuple[int, int], int] = {}
    for place in order.tolist():
        kept.setdefault((int(track[place]), place if track[place] < 0 else 0), place)
    for most in (1, 5, 60, 9000):
        assert best_of_groups(score, track, most).tolist() == list(kept.values())[:most]


def test_a_point_votes_for_its_word_of_highest_cosine() -> None:
    """Not for the first or last word, and not for the lowest; all cosines may be negative."""
    cosines = np.array([[-0.5, -0.4, -0.9, -0.2, -0.3], [-0.3, -0.1, -0.9, -0.2, -0.4]])
    result = vote(cosines, np.array([0, 1]), 2, CLASS_OF_WORD)
    assert (result.class_index.tolist(), result.word_index.tolist()) == ([2, 0], [3, 1])
    np.testing.assert_allclose(result.cosine, [-0.2, -0.1])


def test_more_votes_beat_nearer_votes() -> None:
    cosines = np.array([[0.2, 0.1, 0.1, 0, 0], [0.2, 0.1, 0.1, 0, 0], [0, 0, 0.9, 0, 0]])
    result = vote(cosines, np.zeros(3, int), 1, CLASS_OF_WORD)
    assert result.class_index.tolist() == [0]
    np.testing.assert_allclose([result.share[0], result.cosine[0]], [2 / 3, 0.2])


def test_groups_beyond_the_first_look_are_found() -> None:
    """One track fills the best 100 places; the second best track stands behind them."""
    score, track = np.r_[np.linspace(1, 0.9, 100), 0.5, 0.4], np.r_[np.zeros(100, int), 1, 2]
    assert best_of_groups(score, track, 2).tolist() == [0, 100]
    assert best_of_groups(score, track, 3).tolist() == [0, 100, 101]
