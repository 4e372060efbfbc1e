"""Tracks of any length in parts of bounded length, and what is known of each track as a whole."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from upvl_cli.types import Array, Floats, Ints


@dataclass
class TrackTotals:
    """A few numbers of each track, summed up frame by frame.

    Attributes:
        rows: (k,) boxes of each track; 0 for a number that is no track.
        begin_s: (k,) time of its first box.
        end_s: (k,) time of its last one.
        known: (k,) points of it whose background state is known.
        hits: (k,) points of it that are background.
        num_frames_seen: (k,) frames in which it has points.
    """

    rows: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    begin_s: Floats = field(default_factory=lambda: np.zeros(0))
    end_s: Floats = field(default_factory=lambda: np.zeros(0))
    known: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    hits: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    num_frames_seen: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def add(self, track_id: Ints, time_s: float, num_points: Array) -> None:
        """Add the boxes of a frame.

        Args:
            track_id: (n,) track of each box, each track once.
            time_s: Time of the frame.
            num_points: (n, 3) points of each box: all, those whose state is known, and those of background.
        """
        more = int(track_id.max(initial=-1)) + 1 - len(self.rows)
        if more > 0:
            for spec in fields(self):
                values = getattr(self, spec.name)
                setattr(self, spec.name, np.append(values, np.zeros(more, values.dtype)))
        self.begin_s[track_id] = np.where(self.rows[track_id] == 0, time_s, self.begin_s[track_id])
        self.end_s[track_id] = time_s
        self.rows[track_id] += 1
        self.known[track_id] += num_points[:, 1]
        self.hits[track_id] += num_points[:, 2]
        self.num_frames_seen[track_id] += num_points[:, 0] > 0

    @property
    def background_share(self) -> Floats:
        """(k,) share of background among the points whose state is known; 0 where none is.

        The points of all frames of a track count alike: r_bg of UP-VL, taken of a track and not of a box.
        """
        return np.asarray(self.hits / np.maximum(self.known, 1))

    def parts(self, window_s: float) -> Ints:
        """Return (k,) in how many parts, of about the same number of boxes, none is much longer than a time."""
        return np.maximum(1, np.ceil((self.end_s - self.begin_s) / window_s)).astype(np.int64)


def spread(rows: int, most: int) -> Ints:
    """Return numbers of rows, as evenly spread as they can be, from the first to the last; all where they are few."""
    return np.unique(np.round(np.linspace(0, rows - 1, min(rows, most))).astype(np.int64))


def points_of_boxes(state: Ints, proposal: Ints, box_proposal: Ints) -> Array:
    """Return (b, 3) points of each box of a frame: all, those with a known background state, those of background.

    Args:
        state: (p,) background state of points: 1 background, 0 not, negative unknown; a point of several proposals
            stands there several times.
        proposal: (p,) proposal that each point belongs to, -1 for none.
        box_proposal: (b,) proposal of each box, -1 for a box that the tracker predicted: it has no point.
    """
    total = max(proposal.max(initial=-1), box_proposal.max(initial=-1)) + 1
    counts = []
    for chosen in (np.ones(len(state), dtype=np.bool_), state >= 0, state == 1):
        owner = proposal[chosen & (proposal >= 0)]
        # The last place is that of no proposal.
        counts.append(np.append(np.bincount(owner, minlength=total), 0)[box_proposal])
    return np.stack(counts, axis=1)
