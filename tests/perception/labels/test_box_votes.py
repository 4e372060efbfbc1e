"""Votes of 2D boxes for the names of tracks, counted by hand."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.labels.box_votes import BoxVotes


def add(votes: BoxVotes, *frame: tuple[int, str, float]) -> None:
    track_id, name, score = zip(*frame, strict=True)
    votes.add_frame(np.array(track_id), np.array(name), np.array(score))


def test_the_name_with_the_most_confidence_wins() -> None:
    votes = BoxVotes()
    add(votes, (7, "bus", 0.75), (9, "", 0.0), (3, "car", 0.5))
    add(votes, (7, "train", 0.5), (3, "truck", 0.5))
    add(votes, (7, "train", 0.5))
    found = votes.words(np.array([9, 7, 3, 4]))
    assert found.word.tolist() == ["", "train", "car", ""]  # of equal ones the first in the alphabet
    np.testing.assert_allclose(found.share, [0, 1 / 1.75, 0.5, 0])
    np.testing.assert_allclose(found.votes, [0, 1.75, 1, 0])


def test_no_tracks() -> None:
    assert BoxVotes().words(np.zeros(0, np.int64)).word.tolist() == []
