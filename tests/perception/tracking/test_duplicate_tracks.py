"""Tracks of two hypotheses that say the same, by rows of boxes that a person can count."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.tracking.hypotheses import Hypotheses

# Five frames; boxes 0-4 are those of the first hypothesis, 5-9 of the second, 10-14 of the third.
NUMBER = np.repeat([0, 1, 2], 5)
NONE = np.full(5, -1)


@pytest.mark.parametrize(
    ("twins", "dropped"),
    [
        ([0, 1, 2, 3, 4], True),
        ([0, 1, 2, 3, -1], False),  # four of five are 0.8, which is the limit
        ([-1, -1, -1, -1, -1], False),
    ],
)
def test_a_track_with_more_than_the_share_of_another_goes(twins: list[int], dropped: bool) -> None:
    hypotheses = Hypotheses(NUMBER[:10], np.concatenate([NONE, twins]))
    found = hypotheses.duplicate_tracks([np.arange(5), np.arange(5, 10)], 0.8)
    assert found.tolist() == [False, dropped]


def test_two_tracks_that_another_joins_do_not_drop_it() -> None:
    hypotheses = Hypotheses(NUMBER[:10], np.concatenate([NONE, np.arange(5)]))
    found = hypotheses.duplicate_tracks([np.arange(3), np.arange(3, 5), np.arange(5, 10)], 0.8)
    assert found.tolist() == [False, False, False]


def test_boxes_without_a_track_do_not_count() -> None:
    hypotheses = Hypotheses(NUMBER[:10], np.concatenate([NONE, np.arange(5)]))
    assert hypotheses.duplicate_tracks([np.arange(5, 10)], 0.8).tolist() == [False]


def test_a_duplicate_of_a_duplicate_goes_too() -> None:
    # Two boxes of the third are those of the first, three those of the second: all are of the first track.
    hypotheses = Hypotheses(NUMBER, np.concatenate([NONE, np.arange(5), [0, 1, 7, 8, 9]]))
    found = hypotheses.duplicate_tracks([np.arange(5), np.arange(5, 10), np.arange(10, 15)], 0.8)
    assert found.tolist() == [False, True, True]
