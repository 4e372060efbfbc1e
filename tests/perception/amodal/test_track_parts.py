"""Totals of tracks are those of all frames; parts cover a track and are short."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.amodal.track_parts import TrackTotals, points_of_boxes, spread

NONE = UNKNOWN = -1


def test_a_track_is_as_much_background_as_its_points_of_all_frames() -> None:
    frames = [
        # Track 0 has proposal 1 with two points of background and two others; track 2 coasts.
        ([1, 1, 0, 0, 1, UNKNOWN], [1, 1, 1, 1, NONE, 0], [1, NONE], [0, 2]),
        # Track 0 has one more point, which is none; track 2 has a point of which nobody knows.
        ([0, UNKNOWN], [0, 1], [0, 1], [0, 2]),
        ([], [], [], []),
    ]
    totals = TrackTotals()
    for step, (state, owner, proposal, track_id) in enumerate(frames):
        state, owner, proposal, track_id = (
            np.array(values, dtype=np.int64) for values in (state, owner, proposal, track_id)
        )
        totals.add(track_id, float(step), points_of_boxes(state, owner, proposal))
    assert totals.background_share.tolist() == [0.4, 0, 0]
    assert totals.rows.tolist() == [2, 0, 2]
    assert totals.num_frames_seen.tolist() == [2, 0, 1]
    assert (totals.begin_s[[0, 2]].tolist(), totals.end_s[[0, 2]].tolist()) == ([0, 0], [1, 1])


def test_no_track_has_no_totals() -> None:
    assert TrackTotals().background_share.shape == TrackTotals().parts(1.0).shape == (0,)


@pytest.mark.parametrize(("seconds", "parts"), [(0.0, 1), (30.0, 1), (30.1, 2), (400.0, 14)])
def test_a_track_has_as_many_parts_as_it_lasts_windows(seconds: float, parts: int) -> None:
    totals = TrackTotals()
    for time_s in (5.0, 5.0 + seconds):
        totals.add(np.array([0]), time_s, np.ones((1, 3), np.int64))
    assert totals.parts(30.0).tolist() == [parts]


@pytest.mark.parametrize(
    ("rows", "most", "expected"), [(3, 5, [0, 1, 2]), (9, 3, [0, 4, 8]), (1, 2, [0]), (4000, 2, [0, 3999])]
)
def test_a_choice_reaches_from_the_first_to_the_last(rows: int, most: int, expected: list[int]) -> None:
    assert spread(rows, most).tolist() == expected
