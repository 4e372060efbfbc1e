"""The points of a track vote on its word."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.classify import NO_WORD, OTHER, Votes

KINDS = np.array([1, 1, 2, OTHER])  # two words for vehicles, one for people, one for the rest
BOX = np.array([[10.0, 0, 0, 4, 2, 2, 0], [20.0, 0, 0, 4, 2, 2, 0]])


def one_hot(word: np.ndarray) -> np.ndarray:
    """Features that are nearest to one word each."""
    return np.eye(4)[word]


def test_the_words_of_a_kind_win_together() -> None:
    votes = Votes(KINDS, one_hot)
    word = np.array([0, 1, 2, 2, 1, 3])  # two for each of three words in the first box: vehicle 3, person 2
    xyz = np.array([[10, 0, 0]] * 5 + [[20.0, 0, 0]])
    votes.add(BOX, np.array([7, 8]), xyz, word)
    kind, best, share = votes.of(np.array([8, 7, 9]))
    assert kind.tolist() == [OTHER, 1, OTHER]
    assert best.tolist() == [3, 1, NO_WORD]
    np.testing.assert_allclose(share, [1, 0.6, 0])


def test_votes_of_all_frames_count() -> None:
    votes = Votes(KINDS, one_hot)
    for word in (2, 0, 2):
        votes.add(BOX[:1], np.array([7]), BOX[:1, :3], np.array([word]))
    assert votes.of(np.array([7]))[0].tolist() == [2]


def test_a_box_without_points_has_no_vote() -> None:
    votes = Votes(KINDS, one_hot)
    votes.add(BOX, np.array([7, 8]), np.array([[100.0, 0, 0]]), np.array([0]))
    assert votes.of(np.array([7]))[1].tolist() == [NO_WORD]
