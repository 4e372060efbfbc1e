"""Objects that move by known laws keep their numbers, through gaps and crossings."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.tracking.track import Tracks, track

SETTINGS = {
    "agility_m2ps3": 2.0,
    "position_noise_m": 0.2,
    "velocity_noise_mps": 0.7,
    "gate": 4.0,
    "max_coast_s": 0.5,
    "max_gap_s": 1.5,
    "min_boxes": 4,
    "min_reach_m": 1.0,
    "min_follow": 0.5,
}
TIME_S = np.arange(20) * 0.1
NONE = -1


def seen(*paths: tuple[tuple[float, float], tuple[float, float], list[int]]) -> Tracks:
    """Track objects that start at a place, with a velocity, each seen in some frames."""
    rows = [
        (frame, start[0] + speed[0] * TIME_S[frame], start[1] + speed[1] * TIME_S[frame], *speed)
        for start, speed, frames in paths
        for frame in frames
    ]
    rows.sort(key=lambda row: row[0])
    table = np.array(rows).reshape(-1, 5)
    n = len(table)
    heading = np.arctan2(table[:, 4], table[:, 3])
    seven = np.column_stack([table[:, 1:3], np.full((n, 4), (0.8, 4, 2, 1.5)), heading])
    velocity = np.column_stack([table[:, 3:5], np.zeros(n)])
    return track(table[:, 0].astype(int), seven, velocity, TIME_S, **SETTINGS)


def test_one_car_is_one_track_with_its_velocity() -> None:
    tracks = seen(((0, 0), (8, 1), list(range(20))))
    assert set(tracks.track) == {0}
    np.testing.assert_array_equal(tracks.frame, np.arange(20))
    np.testing.assert_allclose(tracks.velocity_mps[:, :2], np.tile([8, 1], (20, 1)), atol=0.2)


def test_two_that_cross_keep_their_numbers() -> None:
    tracks = seen(((-8, 0), (8, 0), list(range(20))), ((0, -6), (0, 6), list(range(20))))
    assert len(set(tracks.track)) == 2
    for number in set(tracks.track):
        path = tracks.seven[tracks.track == number, :2]
        assert len(path) == 20
        assert np.ptp(path, axis=0).min() < 0.5, "a track turned from one street into the other"


@pytest.mark.parametrize("gap", [[9, 10], [7], [5, 6, 12, 13]])
def test_a_gap_is_filled_where_the_object_was(gap: list[int]) -> None:
    tracks = seen(((0, 0), (8, 0), [frame for frame in range(20) if frame not in gap]))
    assert set(tracks.track) == {0}
    np.testing.assert_array_equal(tracks.frame, np.arange(20))
    np.testing.assert_array_equal(tracks.frame[tracks.box == NONE], gap)
    np.testing.assert_allclose(tracks.seven[gap, 0], 8 * TIME_S[gap], atol=0.3)


def test_what_claims_to_move_and_stays_is_dropped() -> None:
    n = 20
    seven = np.tile([5.0, 0, 0.8, 4, 2, 1.5, 0], (n, 1))
    tracks = track(np.arange(n), seven, np.tile([3.0, 0, 0], (n, 1)), TIME_S, **SETTINGS)
    assert len(tracks.track) == 0
    assert sum(tracks.dropped.values()) >= 1


def test_what_is_seen_a_few_times_only_is_dropped() -> None:
    tracks = seen(((0, 0), (8, 0), [3, 4, 5]))
    assert len(tracks.track) == 0
    assert tracks.dropped["too few boxes"] == 1


def test_nothing_gives_nothing() -> None:
    tracks = seen()
    assert len(tracks.track) == len(tracks.seven) == 0


def test_every_box_is_in_one_track_at_most() -> None:
    tracks = seen(*[((0, 3.0 * lane), (8 - lane, 0), list(range(20))) for lane in range(4)])
    boxes = tracks.box[tracks.box != NONE]
    assert len(boxes) == len(set(boxes)) == 80
    assert len(set(tracks.track)) == 4
