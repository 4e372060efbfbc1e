"""The points of a track vote on its word."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.classes import CYCLIST, OTHER, PEDESTRIAN, VEHICLE
from upvl_cli.perception.labels.classify import NO_WORD, WordVotes
from upvl_cli.types import Boxes, Ragged

TYPES = np.array([VEHICLE, VEHICLE, PEDESTRIAN, OTHER, CYCLIST])  # of five words
BOX = Boxes.from_rows(np.array([[10.0, 0, 0, 4, 2, 2, 0], [20.0, 0, 0, 4, 2, 2, 0]]))


def cosines(word: np.ndarray) -> np.ndarray:
    """Features that are nearest to one word each, and farthest from the next."""
    return 0.5 + 0.5 * np.eye(5)[word] - 0.4 * np.eye(5)[(word + 1) % 5]


def votes_of(*counts: int) -> WordVotes:
    """Track 7 with so many votes for each word."""
    votes = WordVotes(TYPES, cosines)
    word = np.repeat(np.arange(5), counts)
    votes.add_point_features(np.array([7]), Ragged(word, np.array([len(word)])))
    return votes


def result(*counts: int) -> tuple[int, int, float]:
    classes = votes_of(*counts).classify(np.array([7]))
    return int(classes.type[0]), int(classes.word[0]), round(float(classes.share[0]), 3)


def test_the_words_of_a_class_win_together() -> None:
    votes = WordVotes(TYPES, cosines)
    word = np.array([0, 1, 2, 2, 1, 3])  # two for each of three words in the first box: vehicle 3, person 2
    xyz = np.array([[10, 0, 0]] * 5 + [[20.0, 0, 0]])
    votes.add_sweep(BOX, np.array([7, 8]), xyz, word)
    classes = votes.classify(np.array([8, 7, 9]))
    assert classes.type.tolist() == [OTHER, VEHICLE, OTHER]
    assert classes.word.tolist() == [3, 1, NO_WORD]
    np.testing.assert_allclose(classes.share, [1, 0.6, 0])
    types = [np.int8, np.int16, np.float32, np.int16, np.float32, np.bool_]
    assert [part.dtype for part in classes] == types


def test_a_class_of_many_words_beats_the_best_word() -> None:
    assert result(2, 2, 3, 0, 0) == (VEHICLE, 0, 0.571)  # 4 of 7; the best word alone is a pedestrian's


def test_the_word_is_the_best_of_the_class_that_won() -> None:
    assert result(1, 3, 2, 0, 0) == (VEHICLE, 1, 0.667)
    assert result(3, 1, 2, 0, 0) == (VEHICLE, 0, 0.667)
    assert result(0, 0, 1, 0, 5) == (CYCLIST, 4, 0.833)


def test_everything_else_wins_as_a_class_too() -> None:
    assert result(1, 1, 0, 3, 0) == (OTHER, 3, 0.6)


def test_of_equal_classes_the_smaller_number_wins_and_of_equal_words_the_first() -> None:
    assert result(0, 0, 2, 0, 2) == (PEDESTRIAN, 2, 0.5)
    assert result(2, 0, 2, 2, 0) == (OTHER, 3, 0.333)
    assert result(1, 1, 0, 0, 0) == (VEHICLE, 0, 1.0)


def test_votes_of_all_frames_count() -> None:
    votes = WordVotes(TYPES, cosines)
    for word in (2, 0, 2):
        votes.add_sweep(BOX[:1], np.array([7]), BOX.center_m[:1], np.array([word]))
    classes = votes.classify(np.array([7]))
    assert classes.type.tolist() == [PEDESTRIAN]
    np.testing.assert_allclose(classes.share, [2 / 3])


def test_two_boxes_of_one_track_vote_together() -> None:
    votes = WordVotes(TYPES, cosines)
    votes.add_sweep(BOX, np.array([7, 7]), BOX.center_m[[0, 0, 1, 1, 1]], np.array([0, 0, 2, 2, 2]))
    assert votes.classify(np.array([7])).share.tolist() == [np.float32(0.6)]


def test_a_point_in_two_boxes_votes_for_both_and_one_outside_for_none() -> None:
    votes = WordVotes(TYPES, cosines)
    pair = Boxes.from_rows(np.array([[10.0, 0, 0, 4, 2, 2, 0], [12.0, 0, 0, 4, 2, 2, 0]]))
    xyz = np.array([[30.0, 0, 0], [11.0, 0, 0], [8.5, 0, 0], [13.5, 0, 0], [10.0, 1.05, 0]])
    votes.add_sweep(pair, np.array([7, 8]), xyz, np.array([4, 2, 0, 3, 4]))
    counted = {number: votes._votes[number].tolist() for number in (7, 8)}
    assert counted == {7: [1, 0, 1, 0, 0], 8: [0, 0, 1, 1, 0]}


def test_points_whose_box_is_known_vote_for_that() -> None:
    votes = WordVotes(TYPES, cosines)
    votes.add_point_features(np.array([8, 7, 9]), Ragged(np.array([2, 2, 4]), np.array([2, 0, 1])))
    classes = votes.classify(np.array([7, 8, 9]))
    assert classes.type.tolist() == [OTHER, PEDESTRIAN, CYCLIST]
    assert classes.word.tolist() == [NO_WORD, 2, 4]


def test_a_box_without_points_has_no_vote() -> None:
    votes = WordVotes(TYPES, cosines)
    votes.add_sweep(BOX, np.array([7, 8]), np.array([[100.0, 0, 0]]), np.array([0]))
    votes.add_point_features(np.array([7]), Ragged(np.zeros(0, int), np.array([0])))
    classes = votes.classify(np.array([7]))
    assert classes.word.tolist() == [NO_WORD]
    assert classes.share.tolist() == [0]
