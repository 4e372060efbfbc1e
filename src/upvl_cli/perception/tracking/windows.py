"""Tracks through a drive of any length, found window by window of time."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.perception.tracking.hypotheses import Hypotheses
from upvl_cli.perception.tracking.track import Tracks, track
from upvl_cli.perception.windows import Window, overlapping_windows
from upvl_cli.types import Array, Boxes, Floats, Ints, concat


@dataclass(frozen=True)
class FrameTracks:
    """The tracked boxes of one frame, in world axes.

    Attributes:
        track_id: (n,) number of the track, ascending; from 0 on in the order of first boxes.
        box: (n,) row of the box among those of the frame; -1 where the track coasts.
        hypothesis: (n,) number of the hypothesis of the track.
        boxes: n boxes.
        velocity_mps: (n, 3) velocity.
        dropped: How many tracks that would begin in this frame were left out, by reason.
    """

    track_id: Ints
    box: Ints
    hypothesis: Ints
    boxes: Boxes
    velocity_mps: Array
    dropped: Mapping[str, int]


class BoxesOfFrame(NamedTuple):
    """The boxes of one frame, in world axes.

    Attributes:
        boxes: n boxes.
        velocity_mps: (n, 3) velocity of each.
        hypotheses: The hypotheses of the boxes; None where all are of one.
    """

    boxes: Boxes
    velocity_mps: Floats
    hypotheses: Hypotheses | None = None


def track_in_windows(
    frames: Iterable[BoxesOfFrame], time_s: Floats, config: TrackerConfig, max_duplicate_share: float = 1.0
) -> Iterator[FrameTracks]:
    """Yield the tracked boxes of each frame of a drive; those of a drive no longer than a window are `track`'s.

    In a longer drive each frame has the tracks of the window of which it is nearest to the middle. Two windows that
    follow each other see the same boxes for half their length; tracks that share the most of them have one number.

    Args:
        frames: Boxes of T frames; taken only as far ahead as a window reaches.
        time_s: (T,) ascending time of each frame.
        config: Settings.
        max_duplicate_share: As for `track`.
    """
    held: deque[BoxesOfFrame] = deque()
    coming = iter(frames)
    first, boxes_before = 0, 0  # first frame that is held, and the boxes of all before it
    numbers = _TrackNumbers()
    for window in overlapping_windows(time_s, config.window_s):
        while first + len(held) < window.learned.stop:
            held.append(next(coming))
        while first < window.learned.start:
            boxes_before += len(held.popleft().boxes)
            first += 1
        counts = np.array([len(item.boxes) for item in held])
        tracks = track(
            np.repeat(np.arange(len(held)), counts),
            concat([item.boxes for item in held], Boxes),
            np.concatenate([np.zeros((0, 3)), *(item.velocity_mps for item in held)]),
            time_s[window.learned.start : window.learned.stop],
            config,
            _hypotheses_of(held),
            max_duplicate_share,
        )
        number = numbers.of_window(tracks, window, boxes_before)
        yield from _served_frames(tracks, number, window, np.concatenate([[0], np.cumsum(counts)]))


def _hypotheses_of(frames: Iterable[BoxesOfFrame]) -> Hypotheses:
    """Return the hypotheses of the boxes of all frames, one frame after the other."""
    none: Ints = np.zeros(0, np.int64)
    number, duplicate_of, start = [none], [none], 0
    for item in frames:
        here = item.hypotheses or Hypotheses.one(len(item.boxes))
        number.append(here.number)
        duplicate_of.append(np.where(here.duplicate_of >= 0, here.duplicate_of + start, -1))
        start += len(item.boxes)
    return Hypotheses(np.concatenate(number), np.concatenate(duplicate_of))


def _served_frames(tracks: Tracks, number: Ints, window: Window, box_start: Ints) -> Iterator[FrameTracks]:
    """Yield the frames that a window serves.

    Args:
        tracks: The tracks of the window.
        number: (n,) number of the track of each of its rows.
        window: The window.
        box_start: First box of each frame of the window.
    """
    order = np.lexsort((number, tracks.frame))
    dropped = {reason: Counter(frames) for reason, frames in tracks.dropped_from.items()}
    for frame in (step - window.learned.start for step in window.served):
        rows = order[slice(*np.searchsorted(tracks.frame[order], [frame, frame + 1]))]
        box = tracks.box[rows]
        yield FrameTracks(
            number[rows],
            np.where(box >= 0, box - box_start[frame], -1),
            tracks.hypothesis[rows],
            tracks.boxes[rows],
            tracks.velocity_mps[rows],
            {reason: counts[frame] for reason, counts in dropped.items()},
        )


class _TrackNumbers:
    """The numbers of tracks through all windows."""

    def __init__(self) -> None:
        """Start without any track."""
        self._total = 0
        self._box: Ints = np.zeros(
            0, np.int64
        )  # boxes of the window before, counted through the drive, ascending
        self._number: Ints = np.zeros(0, np.int64)  # and the track of each

    def of_window(self, tracks: Tracks, window: Window, boxes_before: int) -> Ints:
        """Return (n,) number of the track of each row of a window; -1 for one that a later window will number.

        Args:
            tracks: The tracks of the window; (n,) rows.
            window: The window.
            boxes_before: Boxes of the drive before those of the window.
        """
        total = int(tracks.track_id.max(initial=-1)) + 1
        number: Ints = np.full(total, -1, dtype=np.int64)
        has_box = tracks.box >= 0
        box, local = tracks.box[has_box] + boxes_before, tracks.track_id[has_box]
        _, here, before = np.intersect1d(box, self._box, assume_unique=True, return_indices=True)
        shared, votes = np.unique(
            np.stack([self._number[before], local[here]], axis=1), axis=0, return_counts=True
        )
        taken = set()
        for (known, track_id), _ in sorted(
            zip(shared.tolist(), votes, strict=True), key=lambda vote: -vote[1]
        ):
            if number[track_id] < 0 and known not in taken:
                number[track_id] = known
                taken.add(known)
        step = tracks.frame + window.learned.start
        is_served = (step >= window.served.start) & (step < window.served.stop)
        for track_id in np.unique(tracks.track_id[is_served]).tolist():
            if number[track_id] < 0:
                number[track_id] = self._total
                self._total += 1
        kept = number[local] >= 0
        self._box, self._number = box[kept], number[local[kept]]
        return np.asarray(number[tracks.track_id])
