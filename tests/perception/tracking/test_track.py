"""Objects that move by known laws keep their numbers, through gaps and crossings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tracker_settings import CONFIG

from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.perception.tracking.motion_model import MotionModel
from upvl_cli.perception.tracking.track import Tracks, track, travels
from upvl_cli.types import Boxes

TIME_S = np.arange(20) * 0.1
NONE = -1


def seen(
    *paths: tuple[tuple[float, float], tuple[float, float], list[int]], config: TrackerConfig = CONFIG
) -> Tracks:
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
    rows = np.column_stack([table[:, 1:3], np.full((n, 4), (0.8, 4, 2, 1.5)), heading])
    velocity = np.column_stack([table[:, 3:5], np.zeros(n)])
    return track(table[:, 0].astype(int), Boxes.from_rows(rows), velocity, TIME_S, config)


def test_one_car_is_one_track_with_its_velocity() -> None:
    tracks = seen(((0, 0), (8, 1), list(range(20))))
    assert set(tracks.track_id) == {0}
    np.testing.assert_array_equal(tracks.frame, np.arange(20))
    np.testing.assert_allclose(tracks.velocity_mps[:, :2], np.tile([8, 1], (20, 1)), atol=0.2)


def test_two_that_cross_keep_their_numbers() -> None:
    tracks = seen(((-8, 0), (8, 0), list(range(20))), ((0, -6), (0, 6), list(range(20))))
    assert len(set(tracks.track_id)) == 2
    for number in set(tracks.track_id):
        path = tracks.boxes.center_m[tracks.track_id == number, :2]
        assert len(path) == 20
        assert np.ptp(path, axis=0).min() < 0.5, "a track turned from one street into the other"


@pytest.mark.parametrize("gap", [[9, 10], [7], [5, 6, 12, 13]])
def test_a_gap_is_filled_where_the_object_was(gap: list[int]) -> None:
    tracks = seen(((0, 0), (8, 0), [frame for frame in range(20) if frame not in gap]))
    assert set(tracks.track_id) == {0}
    np.testing.assert_array_equal(tracks.frame, np.arange(20))
    np.testing.assert_array_equal(tracks.frame[tracks.box == NONE], gap)
    np.testing.assert_allclose(tracks.boxes.center_m[gap, 0], 8 * TIME_S[gap], atol=0.3)


def test_what_claims_to_move_and_stays_is_dropped() -> None:
    n = 20
    rows = np.tile([5.0, 0, 0.8, 4, 2, 1.5, 0], (n, 1))
    tracks = track(np.arange(n), Boxes.from_rows(rows), np.tile([3.0, 0, 0], (n, 1)), TIME_S, CONFIG)
    assert len(tracks.track_id) == 0
    assert tracks.dropped == {"too few boxes": 0, "goes nowhere": 1, "duplicate": 0}
    anything = replace(CONFIG, travel=replace(CONFIG.travel, required=False))
    kept = track(np.arange(n), Boxes.from_rows(rows), np.tile([3.0, 0, 0], (n, 1)), TIME_S, anything)
    assert len(kept.track_id) == n


def test_what_is_seen_a_few_times_only_is_dropped() -> None:
    tracks = seen(((0, 0), (8, 0), [3, 4, 5]))
    assert len(tracks.track_id) == 0
    assert tracks.dropped["too few boxes"] == 1


def test_nothing_gives_nothing() -> None:
    tracks = seen()
    assert len(tracks.track_id) == len(tracks.boxes) == 0


def test_every_box_is_in_one_track_at_most() -> None:
    tracks = seen(*[((0, 3.0 * lane), (8 - lane, 0), list(range(20))) for lane in range(4)])
    boxes = tracks.box[tracks.box != NONE]
    assert len(boxes) == len(set(boxes)) == 80
    assert len(set(tracks.track_id)) == 4


def test_a_track_of_just_enough_boxes_is_kept() -> None:
    assert len(seen(((0, 0), (8, 0), [3, 4, 5, 6])).track_id) == 4


@pytest.mark.parametrize(("sigmas", "tracks"), [(3.9, 1), (4.1, 2)])
def test_a_box_belongs_to_a_track_within_the_gate_only(sigmas: float, tracks: int) -> None:
    """The distance is that of the prediction and the measurement, in standard deviations of both together."""
    box = np.array([[0, 0, 0.8, 4.0, 2.0, 1.5, 0.0]])
    model = MotionModel(CONFIG)
    noise = model.noise(Boxes.from_rows(box))[0]
    transition, drift = model.transition(0.1)
    covariance = transition @ noise @ transition.T + drift + noise
    # An offset along x alone, as far as that many standard deviations.
    offset_m = sigmas / np.sqrt(np.linalg.inv(covariance)[0, 0])
    rows = np.concatenate([box, box + [offset_m, 0, 0, 0, 0, 0, 0]])
    config = replace(CONFIG, min_boxes=1, max_gap_s=0.0, travel=replace(CONFIG.travel, required=False))
    found = track(np.array([0, 1]), Boxes.from_rows(rows), np.zeros((2, 3)), TIME_S, config)
    assert len(set(found.track_id)) == tracks
    # The join of fragments has the same gate.
    joining = replace(config, max_coast_s=0.0, max_gap_s=1.0)
    found = track(np.array([0, 1]), Boxes.from_rows(rows), np.zeros((2, 3)), TIME_S, joining)
    assert len(set(found.track_id)) == tracks


def test_a_track_coasts_for_as_long_as_it_may() -> None:
    config = replace(CONFIG, max_gap_s=0.0, max_coast_s=0.55, min_boxes=1)
    travelling = replace(config, travel=replace(CONFIG.travel, required=False))
    assert len(set(seen(((0, 0), (8, 0), [0, 1, 2, 7, 8]), config=travelling).track_id)) == 1
    assert len(set(seen(((0, 0), (8, 0), [0, 1, 2, 8, 9]), config=travelling).track_id)) == 2


def test_fragments_are_joined_across_gaps_that_are_not_too_long() -> None:
    config = replace(CONFIG, max_coast_s=0.15, max_gap_s=1.05, min_boxes=2)
    assert set(seen(((0, 0), (8, 0), [0, 1, 2, 3, 13, 14, 15]), config=config).track_id) == {0}
    assert set(seen(((0, 0), (8, 0), [0, 1, 2, 3, 14, 15, 16]), config=config).track_id) == {0, 1}


def test_three_fragments_of_one_object_are_one_track() -> None:
    config = replace(CONFIG, max_coast_s=0.15)
    tracks = seen(((0, 0), (8, 0), [0, 1, 2, 3, 8, 9, 14, 15, 16]), config=config)
    assert set(tracks.track_id) == {0}
    np.testing.assert_array_equal(tracks.frame, np.arange(17))


def test_a_fragment_continues_at_the_place_that_the_one_before_leads_to() -> None:
    config = replace(CONFIG, max_coast_s=0.15, min_boxes=2)
    frames = list(range(4)), list(range(12, 17))
    # In frame 12 the first is 9.6 m ahead; the second, 12 m to the side, starts where nothing leads.
    tracks = seen(((0, 0), (8, 0), frames[0]), ((0, 12), (8, 0), frames[1]), config=config)
    assert set(tracks.track_id) == {0, 1}
    assert set(seen(((0, 0), (8, 0), frames[0]), ((0, 0), (8, 0), frames[1]), config=config).track_id) == {0}


def test_a_coasting_box_has_the_tracks_size_and_the_direction_of_its_motion() -> None:
    frames = np.array([0, 1, 2, 3, 6, 7, 8])
    rows = np.zeros((7, 7))
    rows[:, 0], rows[:, 1] = 6 * TIME_S[frames], 8 * TIME_S[frames]
    rows[:, 2] = 1.0 + 0.1 * frames
    rows[:, 3] = [3, 4, 4, 4, 4.2, 5, 5]
    rows[:, 4] = [1.5, 1.6, 1.8, 1.9, 2, 2, 2]
    rows[:, 5] = 1.4 + 0.02 * frames
    rows[:, 6] = 0.3  # what was measured, and not where it moves
    velocity = np.column_stack([np.full(7, 6.0), np.full(7, 8.0), 0.5 * frames])
    tracks = track(frames, Boxes.from_rows(rows), velocity, TIME_S, CONFIG)
    assert tracks.box.tolist() == [0, 1, 2, 3, -1, -1, 4, 5, 6]
    coasting = tracks.boxes[tracks.box == NONE]
    np.testing.assert_allclose(coasting.center_m[:, 0], 6 * TIME_S[[4, 5]], atol=1e-6)
    np.testing.assert_allclose(coasting.center_m[:, 1], 8 * TIME_S[[4, 5]], atol=1e-6)
    np.testing.assert_allclose(coasting.center_m[:, 2], [1.4, 1.5])
    np.testing.assert_allclose(coasting.size_lwh_m, [[4.0, 1.9, 1.48], [4.0, 1.9, 1.5]])
    np.testing.assert_allclose(coasting.heading_rad, np.arctan2(8, 6), atol=1e-6)
    np.testing.assert_allclose(tracks.velocity_mps[:, 2], 0.5 * np.arange(9))
    np.testing.assert_allclose(tracks.velocity_mps[:, :2], np.tile([6, 8], (9, 1)), atol=1e-6)
    np.testing.assert_array_equal(tracks.boxes.to_rows()[tracks.box != NONE], rows)


def test_velocities_are_smoothed_by_what_comes_later() -> None:
    """The first box claims to stand; those after it show that it moved."""
    rows = np.tile([0.0, 0, 0.8, 4, 2, 1.5, 0], (6, 1))
    rows[:, 0] = 3 * TIME_S[:6]
    velocity = np.tile([3.0, 0, 0], (6, 1))
    velocity[0] = 0
    config = replace(CONFIG, travel=replace(CONFIG.travel, required=False))
    tracks = track(np.arange(6), Boxes.from_rows(rows), velocity, TIME_S, config)
    assert set(tracks.track_id) == {0}
    assert tracks.velocity_mps[0, 0] > 1, "the filter alone gives 0"


@pytest.mark.parametrize(
    ("speed_mps", "true_mps", "expected"),
    [
        (3.0, 3.0, True),  # it moves as it claims
        (3.0, 1.6, True),  # by more than half of it
        (3.0, 1.4, False),  # by less
        (3.0, -3.0, False),  # the other way
        (0.9, 0.9, False),  # 0.9 m in a second
        (1.1, 1.1, True),
        (0.0, 3.0, False),  # it claims to stand
    ],
)
def test_a_track_travels_where_its_boxes_follow_its_velocities(
    speed_mps: float, true_mps: float, expected: bool
) -> None:
    time_s = np.linspace(0, 1, 11)
    state = np.zeros((11, 4))
    state[:, 1], state[:, 3] = 7 + true_mps * time_s, speed_mps
    assert travels(state, time_s, CONFIG.travel) is expected


def test_who_turns_back_has_travelled_and_uneven_speeds_are_integrated() -> None:
    time_s = np.linspace(0, 2, 21)
    there_and_back = np.zeros((21, 4))
    there_and_back[:, 0], there_and_back[:, 2] = (
        3 * np.sin(np.pi * time_s / 2),
        1.5 * np.pi * np.cos(np.pi * time_s / 2),
    )
    assert travels(there_and_back, time_s, CONFIG.travel), "farthest from the first box, not at the end"
    speeding_up = np.zeros((3, 4))
    # From 0 to 2 m/s in a second, the trapezoid of which is 1 m: just far enough; then for a moment.
    speeding_up[:, 2], speeding_up[:, 0] = [0, 2, 2], [0, 1, 1.002]
    assert travels(speeding_up, np.array([0.0, 1.0, 1.001]), CONFIG.travel)
    assert not travels(speeding_up[:2] * 0.9, np.array([0.0, 1.0]), CONFIG.travel)


def test_tracks_are_numbered_by_their_first_boxes() -> None:
    tracks = seen(((0, 0), (8, 0), list(range(5, 20))), ((0, 20), (8, 0), list(range(15))))
    firsts = [tracks.boxes.center_m[tracks.track_id == number][0] for number in (0, 1)]
    assert firsts[0][1] == 20
    assert tracks.frame[tracks.track_id == 1][0] == 5


def test_a_box_belongs_to_the_nearer_of_two_tracks() -> None:
    rows = np.array([[0, y, 0.8, 4, 2, 1.5, 0] for y in (0.0, 1.5, 0.1, 1.6, 0.0, 1.5, 0.1, 1.6)])
    config = replace(CONFIG, travel=replace(CONFIG.travel, required=False))
    tracks = track(np.repeat(np.arange(4), 2), Boxes.from_rows(rows), np.zeros((8, 3)), TIME_S, config)
    assert tracks.box.tolist() == [0, 2, 4, 6, 1, 3, 5, 7]


def test_limits_of_time_are_reached_and_not_passed() -> None:
    """Half a second is no longer than half a second, for a track that coasts and for fragments."""
    still = replace(CONFIG, min_boxes=1, travel=replace(CONFIG.travel, required=False))
    path = ((0.0, 0.0), (8.0, 0.0), [0, 5])
    assert TIME_S[5] == 0.5
    assert set(seen(path, config=replace(still, max_coast_s=0.5, max_gap_s=0.0)).track_id) == {0}
    assert set(seen(path, config=replace(still, max_coast_s=0.0, max_gap_s=0.5)).track_id) == {0}
    assert set(seen(path, config=replace(still, max_coast_s=0.49, max_gap_s=0.49)).track_id) == {0, 1}


def test_a_fragment_begins_where_all_of_its_boxes_say() -> None:
    """Its first box is off by 0.6 m, and would not be within the gate; the boxes after it put that right."""
    frames = np.array([0, 1, 2, 3, 7, 8, 9, 10, 11, 12])
    rows = np.tile([0.0, 0, 0.8, 0.1, 0.1, 1.5, 0], (10, 1))
    rows[4, 1] = 0.6
    boxes, velocity = Boxes.from_rows(rows), np.zeros((10, 3))
    config = replace(
        CONFIG,
        acceleration_psd_m2ps3=0.01,
        velocity_noise_mps=0.1,
        max_coast_s=0.15,
        gate_sigma=2.5,
        min_boxes=1,
        travel=replace(CONFIG.travel, required=False),
    )
    assert set(track(frames, boxes, velocity, TIME_S, config).track_id) == {0}
    first_alone = track(frames[:5], boxes[:5], velocity[:5], TIME_S, config)
    assert set(first_alone.track_id) == {0, 1}, "that box alone is too far off"


@pytest.mark.parametrize(("rate_hz", "kept"), [(10.0, 4), (5.0, 4), (2.0, 2), (1.934, 2)])
def test_limits_hold_at_any_rate(rate_hz: float, kept: int) -> None:
    """At 2 Hz consecutive boxes are as far apart in time as a track coasts at 10 Hz."""
    at = CONFIG.at_rate(1 / rate_hz)
    assert at.min_boxes == kept
    assert at.max_coast_s >= 1.2 / rate_hz and at.max_gap_s >= 2.2 / rate_hz
    if rate_hz >= 5:
        assert at == CONFIG
    assert CONFIG.at_rate(0.0) == CONFIG


def test_an_object_seen_each_half_second_has_a_track() -> None:
    """Five key frames of a car at 10 m/s."""
    time_s = np.arange(5) * 0.517
    boxes = Boxes(
        np.column_stack([10 * time_s, np.zeros((5, 2))]), np.tile([4.0, 2.0, 1.5], (5, 1)), np.zeros(5)
    )
    found = track(np.arange(5), boxes, np.tile([10.0, 0, 0], (5, 1)), time_s, CONFIG)
    assert found.track_id.tolist() == [0] * 5
    pair = track(np.arange(2), boxes[:2], np.tile([10.0, 0, 0], (2, 1)), time_s, CONFIG)
    assert len(pair.track_id) == 2


STANDING = replace(CONFIG, travel=replace(CONFIG.travel, required=False))


def pieces(frames: list[list[int]], offset_m: float, config: TrackerConfig, speed_mps: float = 8.0) -> Tracks:
    """A car in two pieces, each seen in some frames, the second one so far ahead of the first, and shorter."""
    rows = [
        (frame, number, speed_mps * TIME_S[frame] + offset_m * number, 2.0 - number)
        for number, seen_in in enumerate(frames)
        for frame in seen_in
    ]
    rows.sort()
    table = np.array(rows)
    boxes = np.zeros((len(table), 7))
    boxes[:, 0], boxes[:, 3], boxes[:, 4:6] = table[:, 2], table[:, 3], 1.0
    velocity = np.zeros((len(table), 3))
    velocity[:, 0] = speed_mps
    return track(table[:, 0].astype(int), Boxes.from_rows(boxes), velocity, TIME_S, config)


@pytest.mark.parametrize(
    ("overlap", "offset_m", "max_overlap_s", "tracks"),
    [
        (4, 0.5, 0.5, 1),
        (4, 0.5, 0.0, 2),
        (8, 0.5, 0.5, 2),  # 0.7 s beside each other
        (4, 3.0, 0.5, 2),  # too far apart for one object
    ],
)
def test_a_piece_that_goes_on_is_of_the_same_track(
    overlap: int, offset_m: float, max_overlap_s: float, tracks: int
) -> None:
    first, second = list(range(12)), list(range(12 - overlap, 20))
    config = replace(STANDING, max_overlap_s=max_overlap_s)
    found = pieces([first, second], offset_m, config)
    assert len(set(found.track_id)) == tracks
    if tracks == 1:
        np.testing.assert_array_equal(found.frame, np.arange(20))
        # Of two boxes in one frame the larger one is kept.
        np.testing.assert_array_equal(found.boxes.size_lwh_m[:, 0], [2.0] * 12 + [1.0] * 8)


def test_a_piece_that_ends_before_the_other_does_is_no_successor() -> None:
    found = pieces([list(range(20)), [16, 17, 18]], 0.5, replace(STANDING, min_boxes=1))
    assert sorted(np.bincount(found.track_id).tolist()) == [3, 20]


@pytest.mark.parametrize(
    ("speed_mps", "max_standing_gap_s", "tracks"), [(0.0, 3.0, 1), (0.0, 1.0, 2), (8.0, 3.0, 2)]
)
def test_what_stands_still_is_found_again_after_a_longer_gap(
    speed_mps: float, max_standing_gap_s: float, tracks: int
) -> None:
    """Two seconds, of 30 frames at 10 Hz, in which a bus hides a parked car: no box is made up for them."""
    seen_in, time_s = [*range(5), *range(25, 30)], np.arange(30) * 0.1
    boxes = np.zeros((10, 7))
    boxes[:, 0], boxes[:, 3:6] = speed_mps * time_s[seen_in], (4, 2, 1.5)
    velocity = np.zeros((10, 3))
    velocity[:, 0] = speed_mps
    config = replace(STANDING, max_gap_s=0.5, max_standing_gap_s=max_standing_gap_s)
    found = track(np.array(seen_in), Boxes.from_rows(boxes), velocity, time_s, config)
    assert len(set(found.track_id)) == tracks
    np.testing.assert_array_equal(found.frame, seen_in)


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 20.0])
def test_one_track_at_any_rate_through_a_gap(rate_hz: float) -> None:
    """A car at 8 m/s, measured to 0.1 m, that is hidden for a second in the middle of six."""
    rng = np.random.default_rng(0)
    time_s = np.arange(0, 6, 1 / rate_hz)
    seen_in = np.flatnonzero((time_s < 2.5) | (time_s >= 3.5))
    boxes = np.zeros((len(seen_in), 7))
    boxes[:, 0], boxes[:, 3:6] = 8 * time_s[seen_in], (4, 2, 1.5)
    boxes[:, :2] += rng.normal(0, 0.1, (len(seen_in), 2))
    velocity = np.zeros((len(seen_in), 3))
    velocity[:, :2] = [8.0, 0.0] + rng.normal(0, 0.3, (len(seen_in), 2))
    found = track(seen_in, Boxes.from_rows(boxes), velocity, time_s, STANDING)
    assert set(found.track_id) == {0}
    assert len(found.frame) == len(time_s)
