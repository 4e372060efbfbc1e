"""A drive that is tracked window by window has the tracks of the whole drive, and holds a window only."""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from tracker_settings import CONFIG

from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.perception.tracking.hypotheses import Hypotheses
from upvl_cli.perception.tracking.track import track
from upvl_cli.perception.tracking.windows import BoxesOfFrame, FrameTracks, track_in_windows
from upvl_cli.types import Boxes, concat

STEP_S, FRAMES = 0.2, 300  # a minute
STILL = replace(CONFIG, window_s=16.0, travel=replace(CONFIG.travel, required=False))


def traffic() -> list[BoxesOfFrame]:
    """One car that is followed for the minute, with gaps; a parked one, and cars that come and go on their lanes."""
    rng = np.random.default_rng(1)
    paths = [(0, FRAMES, (0.0, 0.0), 8.0), (0, FRAMES, (5.0, 10.0), 0.0)]
    paths += [(start, start + 25, (8.0 * start * STEP_S, -8.0), -9.0) for start in range(0, FRAMES - 25, 20)]
    frames = []
    for step in range(FRAMES):
        rows = [
            (x + speed * (step - start) * STEP_S, y, 0.8, 4, 2, 1.5, 0.0, speed)
            for start, end, (x, y), speed in paths
            if start <= step < end and rng.random() > 0.1
        ]
        table = np.array(rows).reshape(-1, 8)
        table[:, :2] += rng.normal(0, 0.05, (len(table), 2))
        velocity = np.zeros((len(table), 3))
        velocity[:, 0] = table[:, 7]
        frames.append(BoxesOfFrame(Boxes.from_rows(table[:, :7]), velocity))
    return frames


def windowed(frames: list[BoxesOfFrame], config: TrackerConfig) -> list[FrameTracks]:
    return list(track_in_windows(frames, np.arange(len(frames)) * STEP_S, config))


def whole(frames: list[BoxesOfFrame], config: TrackerConfig) -> list[FrameTracks]:
    """The plain way: all frames at once, cut into frames."""
    counts = [len(item.boxes) for item in frames]
    step, start = np.repeat(np.arange(len(frames)), counts), np.cumsum([0, *counts])
    boxes = concat([item.boxes for item in frames], Boxes)
    velocity = np.concatenate([item.velocity_mps for item in frames])
    found = track(step, boxes, velocity, np.arange(len(frames)) * STEP_S, config)
    result = []
    for number in range(len(frames)):
        rows = found.frame == number
        box = np.where(found.box[rows] < 0, -1, found.box[rows] - start[number])
        result.append(
            FrameTracks(
                found.track_id[rows],
                box,
                found.hypothesis[rows],
                found.boxes[rows],
                found.velocity_mps[rows],
                {},
            )
        )
    return result


@pytest.mark.parametrize("frames", [0, 1, 80])
def test_a_drive_no_longer_than_a_window_is_tracked_as_a_whole_to_the_bit(frames: int) -> None:
    drive = traffic()[:frames]
    for found, expected in zip(windowed(drive, STILL), whole(drive, STILL), strict=True) if frames else []:
        np.testing.assert_array_equal(found.track_id, expected.track_id)
        np.testing.assert_array_equal(found.box, expected.box)
        np.testing.assert_array_equal(found.boxes.to_rows(), expected.boxes.to_rows())
        np.testing.assert_array_equal(found.velocity_mps, expected.velocity_mps)


def test_a_long_drive_has_the_tracks_of_the_whole_drive() -> None:
    drive = traffic()
    found, expected = windowed(drive, STILL), whole(drive, STILL)
    assert len(found) == FRAMES
    assert len({number for frame in expected for number in frame.track_id}) == 16
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.track_id, other.track_id)
        np.testing.assert_array_equal(one.box, other.box)
        # What is 4 s away no longer counts for the smoother.
        np.testing.assert_allclose(one.velocity_mps, other.velocity_mps, atol=0.01)
        np.testing.assert_allclose(one.boxes.center_m, other.boxes.center_m, atol=0.01)


def test_tracks_that_are_dropped_are_counted_once() -> None:
    blink = [BoxesOfFrame(Boxes.from_rows(np.array([[0, 0, 0.8, 4, 2, 1.5, 0.0]])), np.zeros((1, 3)))]
    nothing = [BoxesOfFrame(concat([], Boxes), np.zeros((0, 3)))]
    drive = [*nothing * 20, *blink * 2, *nothing * 100, *blink, *nothing * 100, *blink * 3, *nothing * 40]
    found = windowed(drive, STILL)
    assert [step for step, frame in enumerate(found) if frame.dropped.get("too few boxes")] == [20, 122, 223]
    assert sum(len(frame.track_id) for frame in found) == 0


class Batch(np.ndarray):
    """Velocities that can be referred to weakly."""


def test_the_boxes_of_a_window_are_held_and_no_more() -> None:
    drive, live, most = traffic(), weakref.WeakSet(), 0

    def frames() -> Iterator[BoxesOfFrame]:
        for item in drive:
            batch = item.velocity_mps.view(Batch)
            live.add(Held(batch))
            yield BoxesOfFrame(item.boxes, batch)

    for _ in track_in_windows(frames(), np.arange(FRAMES) * STEP_S, STILL):
        most = max(most, len(live))
    assert 0 < most <= 16 / STEP_S + 2


class Held:
    """Lives as long as the velocities of a frame."""

    def __init__(self, batch: Batch) -> None:
        batch.held = self


def test_tracks_of_two_hypotheses_keep_apart_and_duplicates_go() -> None:
    """The second hypothesis has the same car, and one more that the first one does not know."""
    stray = BoxesOfFrame(Boxes.from_rows(np.array([[99, 99, 0.8, 4, 2, 1.5, 0.0]])), np.zeros((1, 3)))
    drive = [stray, *traffic()[:78]]
    doubled = [stray]
    for item in drive[1:]:
        total = len(item.boxes)
        other = np.column_stack([item.boxes.to_rows()[:1]])
        other[:, 1] += 20.0
        boxes = concat([item.boxes, item.boxes[:1], Boxes.from_rows(other)], Boxes) if total else item.boxes
        velocity = np.concatenate([item.velocity_mps, item.velocity_mps[:1], item.velocity_mps[:1]])
        number = np.repeat([0, 1], [total, len(boxes) - total])
        twin = np.append(np.full(total, -1), [0, -1]) if total else np.zeros(0, np.int64)
        doubled.append(BoxesOfFrame(boxes, velocity[: len(boxes)], Hypotheses(number, twin)))
    time_s = np.arange(len(drive)) * STEP_S
    plain = windowed(drive, STILL)
    found = list(track_in_windows(doubled, time_s, STILL, max_duplicate_share=0.8))
    for one, other in zip(found, plain, strict=True):
        first = one.hypothesis == 0
        np.testing.assert_array_equal(one.boxes[first].to_rows(), other.boxes.to_rows())
    assert {int((frame.hypothesis == 1).sum()) for frame in found[1:]} == {1}
    for hypothesis in (0, 1):
        numbers = {k for frame in found for k in frame.track_id[frame.hypothesis == hypothesis].tolist()}
        assert not numbers & {
            k for frame in found for k in frame.track_id[frame.hypothesis != hypothesis].tolist()
        }
    assert sum(frame.dropped["duplicate"] for frame in found) == 1
    kept = list(track_in_windows(doubled, time_s, STILL))
    assert {int((frame.hypothesis == 1).sum()) for frame in kept[1:]} == {2}
