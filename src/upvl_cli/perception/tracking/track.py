"""Tracks of objects through one segment, from the boxes of its sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from upvl_cli.perception.tracking.association import Fragments, associate, join_fragments
from upvl_cli.perception.tracking.config import TrackerConfig, TravelConfig
from upvl_cli.perception.tracking.hypotheses import Hypotheses
from upvl_cli.perception.tracking.measurements import Measurements
from upvl_cli.perception.tracking.motion_model import MotionModel
from upvl_cli.types import Array, Boxes, Floats, Ints, concat

COASTING = -1  # box of a track in a frame where it has none


@dataclass(frozen=True)
class Tracks:
    """Tracked boxes in world axes, one a track and frame, sorted by track and then frame.

    Attributes:
        track_id: (n,) number of the track, from 0 on in the order of its first box.
        frame: (n,) number of the frame.
        box: (n,) row of the box among those that were tracked; -1 where the track coasts.
        hypothesis: (n,) number of the hypothesis of the track.
        boxes: n boxes; where coasting, of the track's median length and width at the filter's position.
        velocity_mps: (n, 3) velocity by the smoother; z as measured.
        dropped_from: First frame of each track that was left out, by reason.
    """

    track_id: Ints
    frame: Ints
    box: Ints
    hypothesis: Ints
    boxes: Boxes
    velocity_mps: Array
    dropped_from: Mapping[str, Sequence[int]]

    @property
    def dropped(self) -> dict[str, int]:
        """How many tracks were left out, by reason."""
        return {reason: len(frames) for reason, frames in self.dropped_from.items()}


def track(
    frame: Ints,
    boxes: Boxes,
    velocity_mps: Floats,
    time_s: Floats,
    config: TrackerConfig,
    hypotheses: Hypotheses | None = None,
    max_duplicate_share: float = 1.0,
) -> Tracks:
    """Associate the boxes of all frames to tracks, join the fragments of a track, and fill its gaps.

    UP-VL, Algorithm 1, line 7, names the step; the tracker is AB3DMOT's (Weng et al., 2020): a Kalman filter, a
    gate and the Hungarian algorithm, here on centers and velocities, with a smoother after it.

    Args:
        frame: (n,) number of the frame of each box, ascending.
        boxes: n boxes in world axes.
        velocity_mps: (n, 3) their velocities in world axes.
        time_s: (T,) ascending time of each frame.
        config: Settings.
        hypotheses: Which boxes are tracked with each other; None tracks all of them together.
        max_duplicate_share: Largest share of its boxes that a track of a later hypothesis may have in common with one
            track of an earlier one.
    """
    config = config.at_rate(float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0)
    if hypotheses is None:
        hypotheses = Hypotheses.one(len(frame))
    model = MotionModel(config)
    measured = Measurements.of_boxes(model, frame, boxes, velocity_mps, time_s)
    found: list[_FoundTrack] = []
    dropped: dict[str, list[int]] = {"too few boxes": [], "goes nowhere": []}
    for number in range(hypotheses.number.max(initial=0) + 1):
        for item in _tracks_of(model, measured, np.flatnonzero(hypotheses.number == number), config):
            if len(item.rows) < config.min_boxes:
                dropped["too few boxes"].append(int(frame[item.rows[0]]))
            elif config.travel.required and not _travels(measured, item.rows, config):
                dropped["goes nowhere"].append(int(frame[item.rows[0]]))
            else:
                found.append(item)
    is_duplicate = hypotheses.duplicate_tracks([item.rows for item in found], max_duplicate_share)
    dropped["duplicate"] = [int(frame[found[k].rows[0]]) for k in np.flatnonzero(is_duplicate).tolist()]
    kept = [item for item, is_dropped in zip(found, is_duplicate.tolist(), strict=True) if not is_dropped]
    kept.sort(key=lambda item: int(item.rows[0]))
    pieces = [_filled_track(measured, item, number, config.max_gap_s) for number, item in enumerate(kept)]
    first = np.array([item.rows[0] for item in kept], dtype=np.int64)
    return _stack(pieces, hypotheses.number[first], dropped)


class _FoundTrack(NamedTuple):
    """The boxes of a track, ascending, and its states in all frames from its first to its last."""

    rows: Ints
    states: Array


def _tracks_of(
    model: MotionModel, measured: Measurements, rows: Ints, config: TrackerConfig
) -> Iterator[_FoundTrack]:
    """Yield the tracks of some boxes, in the order of their first boxes."""
    fragments = associate(model, measured, rows, config)
    fits = measured.smooth(model, fragments)
    tracks = join_fragments(model, Fragments.of_rows(measured, fragments, fits), config)
    chains = [
        _one_a_frame(measured, np.concatenate([fragments[link] for link in links]))
        for links in tracks
        if len(links) > 1
    ]
    chain_fits = iter(zip(chains, measured.smooth(model, chains), strict=True))
    for links in tracks:
        if len(links) > 1:
            boxes, (states, _) = next(chain_fits)
        else:
            boxes, states = fragments[links[0]], fits[links[0]][0]
        yield _FoundTrack(boxes, states)


def _one_a_frame(measured: Measurements, rows: Ints) -> Ints:
    """Return some boxes in the order of their frames, of each frame the one that covers the most ground."""
    area_m2 = measured.boxes.size_lwh_m[rows, 0] * measured.boxes.size_lwh_m[rows, 1]
    ordered = rows[np.lexsort((rows, -area_m2, measured.frame[rows]))]
    return np.asarray(ordered[np.append(True, np.diff(measured.frame[ordered]) > 0)])


def _travels(measured: Measurements, rows: Ints, config: TrackerConfig) -> bool:
    return travels(measured.state[rows], measured.time_of(rows), config.travel)


def travels(state: Floats, time_s: Floats, config: TravelConfig) -> bool:
    """Return whether the velocities of a track take it somewhere, and its boxes follow them there.

    Args:
        state: (n, 4) x, y, vx, vy of its boxes.
        time_s: (n,) ascending time of each.
        config: Settings; `required` has no say here.
    """
    steps = np.diff(time_s)[:, None] * (state[1:, 2:] + state[:-1, 2:]) / 2  # trapezoidal rule
    integrated = np.vstack([np.zeros(2), steps.cumsum(axis=0)])
    distance_m = np.linalg.norm(integrated - integrated[0], axis=1).max()
    integrated = integrated - integrated.mean(axis=0)
    centers = state[:, :2] - state[:, :2].mean(axis=0)
    # Of the least squares line of the centers over the integrated velocity: 1 for any path truly taken.
    slope = (centers * integrated).sum() / max((integrated**2).sum(), np.finfo(float).tiny)
    return bool(distance_m >= config.min_distance_m and slope >= config.min_path_slope)


def _filled_track(
    measured: Measurements, item: _FoundTrack, number: int, max_gap_s: float
) -> tuple[Array, Array, Array, Boxes, Array]:
    """Return one track as columns: number, frame, box, boxes, velocity; its gaps filled, but for longer ones."""
    rows, states = item
    seen, boxes = measured.frame[rows], measured.boxes[rows]
    frame = np.arange(seen[0], seen[-1] + 1)
    box = np.full(len(frame), COASTING, dtype=np.int64)
    box[seen - seen[0]] = rows
    vertical = [boxes.center_m[:, 2], boxes.size_lwh_m[:, 2], measured.velocity_mps[rows, 2]]
    z_m, height_m, vertical_mps = (np.interp(frame, seen, values) for values in vertical)
    center_m = np.column_stack([states[:, :2], z_m])
    flat_m = np.tile(np.median(boxes.size_lwh_m[:, :2], axis=0), (len(frame), 1))
    size_lwh_m = np.column_stack([flat_m, height_m])
    heading_rad = np.arctan2(states[:, 3], states[:, 2])
    for filled, known in (
        (center_m, boxes.center_m),
        (size_lwh_m, boxes.size_lwh_m),
        (heading_rad, boxes.heading_rad),
    ):
        filled[seen - seen[0]] = known
    velocity_mps = np.column_stack([states[:, 2:], vertical_mps])
    next_seen = np.searchsorted(seen, frame)
    gap_s = measured.time_s[seen[next_seen]] - measured.time_s[seen[np.maximum(next_seen - 1, 0)]]
    kept = np.flatnonzero((box != COASTING) | (gap_s <= max_gap_s))
    all_boxes = Boxes(center_m, size_lwh_m, heading_rad)[kept]
    return np.full(len(kept), number), frame[kept], box[kept], all_boxes, velocity_mps[kept]


def _stack(
    pieces: Sequence[tuple[Array, Array, Array, Boxes, Array]],
    hypothesis: Ints,
    dropped: Mapping[str, list[int]],
) -> Tracks:
    if not pieces:
        none = np.zeros(0, dtype=np.int64)
        return Tracks(none, none, none, none, concat([], Boxes), np.zeros((0, 3)), dropped)
    number, frame, box, boxes, velocity_mps = zip(*pieces, strict=True)
    return Tracks(
        np.concatenate(number),
        np.concatenate(frame),
        np.concatenate(box),
        hypothesis[np.concatenate(number)],
        concat(boxes, Boxes),
        np.concatenate(velocity_mps),
        dropped,
    )
