"""Tracks of objects through one segment, from the boxes of its sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.tracking.assignment import assign, assign_pairs
from upvl_cli.perception.tracking.config import TrackerConfig, TravelConfig
from upvl_cli.perception.tracking.motion_model import MotionModel, squared_distance, update
from upvl_cli.types import Array, Boxes, Floats, Ints, concat

COASTING = -1  # box of a track in a frame where it has none


@dataclass(frozen=True)
class Tracks:
    """Tracked boxes in world axes, one a track and frame, sorted by track and then frame.

    Attributes:
        track_id: (n,) number of the track, from 0 on in the order of its first box.
        frame: (n,) number of the frame.
        box: (n,) row of the box among those that were tracked; -1 where the track coasts.
        boxes: n boxes; where coasting, of the track's median length and width at the filter's position.
        velocity_mps: (n, 3) velocity by the smoother; z as measured.
        dropped_from: First frame of each track that was left out, by reason.
    """

    track_id: Ints
    frame: Ints
    box: Ints
    boxes: Boxes
    velocity_mps: Array
    dropped_from: Mapping[str, Sequence[int]]

    @property
    def dropped(self) -> dict[str, int]:
        """How many tracks were left out, by reason."""
        return {reason: len(frames) for reason, frames in self.dropped_from.items()}


@dataclass(frozen=True)
class _Measurements:
    """The boxes of a segment in world axes, as the filter takes them.

    Attributes:
        frame: (n,) number of the frame of each, ascending.
        boxes: n boxes.
        velocity_mps: (n, 3) velocities.
        state: (n, 4) x, y, vx, vy.
        noise: (n, 4, 4) covariance of each state.
        time_s: (T,) ascending time of each frame.
    """

    frame: Ints
    boxes: Boxes
    velocity_mps: Floats
    state: Floats
    noise: Floats
    time_s: Floats

    def time_of(self, row: Ints | int) -> Array:
        """Return the times of some of the boxes."""
        return np.asarray(self.time_s[self.frame[row]])


@dataclass
class _OpenTrack:
    """A track while the frames go by: its boxes, and the filter's state at the last of them."""

    state: Array
    covariance: Array
    rows: list[int]
    time_s: float


def track(frame: Ints, boxes: Boxes, velocity_mps: Floats, time_s: Floats, config: TrackerConfig) -> Tracks:
    """Associate the boxes of all frames to tracks, join the fragments of a track, and fill its gaps.

    UP-VL, Algorithm 1, line 7, names the step; the tracker is AB3DMOT's (Weng et al., 2020): a Kalman filter, a
    gate and the Hungarian algorithm, here on centers and velocities, with a smoother after it.

    Args:
        frame: (n,) number of the frame of each box, ascending.
        boxes: n boxes in world axes.
        velocity_mps: (n, 3) their velocities in world axes.
        time_s: (T,) ascending time of each frame.
        config: Settings.
    """
    config = config.at_rate(float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0)
    model = MotionModel(config)
    state = np.hstack([boxes.center_m[:, :2], velocity_mps[:, :2]])
    measured = _Measurements(frame, boxes, velocity_mps, state, model.noise(boxes), time_s)
    fragments = _associate(model, measured, config)
    dropped: dict[str, list[int]] = {"too few boxes": [], "goes nowhere": []}
    found = []
    for rows in _join_fragments(model, measured, fragments, config):
        if len(rows) < config.min_boxes:
            dropped["too few boxes"].append(int(frame[rows[0]]))
        elif config.travel.required and not travels(state[rows], measured.time_of(rows), config.travel):
            dropped["goes nowhere"].append(int(frame[rows[0]]))
        else:
            found.append(rows)
    pieces = [_filled_track(model, measured, rows, number) for number, rows in enumerate(found)]
    return _stack(pieces, dropped)


def _associate(model: MotionModel, measured: _Measurements, config: TrackerConfig) -> list[Ints]:
    """Return the boxes of each track by one pass through time, in the order of their first boxes."""
    tracks: list[_OpenTrack] = []
    active: list[_OpenTrack] = []
    for frame in np.unique(measured.frame):
        rows = np.arange(*np.searchsorted(measured.frame, [frame, frame + 1]))
        time_s = float(measured.time_s[frame])
        active = [item for item in active if time_s - item.time_s <= config.max_coast_s]
        state, covariance = model.predict(
            np.array([item.state for item in active]).reshape(-1, 4),
            np.array([item.covariance for item in active]).reshape(-1, 4, 4),
            time_s - np.array([item.time_s for item in active]),
        )
        offset = measured.state[rows] - state[:, None]
        cost = squared_distance(offset, covariance[:, None] + measured.noise[rows])
        pairs = assign(np.where(cost <= config.gate_sigma**2, cost, np.inf))
        for place, column in zip(*pairs, strict=True):
            item, row = active[place], rows[column]
            item.state, item.covariance = update(
                state[place], covariance[place], measured.state[row], measured.noise[row]
            )
            item.rows.append(int(row))
            item.time_s = time_s
        for row in np.delete(rows, pairs[1]):
            active.append(_OpenTrack(measured.state[row], measured.noise[row], [int(row)], time_s))
            tracks.append(active[-1])
    return [np.array(item.rows) for item in tracks]


def _smooth(model: MotionModel, measured: _Measurements, rows: Ints) -> tuple[Array, Array]:
    """Return the states and covariances of one track in all frames from its first to its last."""
    frame = measured.frame[rows]
    first, last = frame[0], frame[-1]
    state, noise = np.full((last - first + 1, 4), np.nan), np.zeros((last - first + 1, 4, 4))
    state[frame - first], noise[frame - first] = measured.state[rows], measured.noise[rows]
    return model.filter(measured.time_s[first : last + 1], state, noise)


def _join_fragments(
    model: MotionModel, measured: _Measurements, fragments: Sequence[Ints], config: TrackerConfig
) -> list[Ints]:
    """Return the boxes of each track where a fragment that begins within the gate of another's end belongs to it."""
    fits = [_smooth(model, measured, rows) for rows in fragments]
    starts_s = np.array([measured.time_of(rows[0]) for rows in fragments])  # ascending
    pairs: list[tuple[int, int, float]] = []
    for i, (rows, (states, covariances)) in enumerate(zip(fragments, fits, strict=True)):
        gap_s = starts_s - measured.time_of(rows[-1])
        for j in np.flatnonzero((gap_s > 0) & (gap_s <= config.max_gap_s)).tolist():
            state, covariance = model.predict(states[-1], covariances[-1], gap_s[j])
            cost = squared_distance(fits[j][0][0] - state, fits[j][1][0] + covariance)
            if cost <= config.gate_sigma**2:
                pairs.append((i, j, float(cost)))
    successor = assign_pairs(pairs)
    tracks = []
    for first in sorted(set(range(len(fragments))) - set(successor.values())):
        links = [first]
        while links[-1] in successor:
            links.append(successor[links[-1]])
        tracks.append(np.concatenate([fragments[link] for link in links]))
    return tracks


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
    model: MotionModel, measured: _Measurements, rows: Ints, number: int
) -> tuple[Array, Array, Array, Boxes, Array]:
    """Return one track as columns: number, frame, box, boxes, velocity; its gaps filled."""
    seen, boxes = measured.frame[rows], measured.boxes[rows]
    frame = np.arange(seen[0], seen[-1] + 1)
    states, _ = _smooth(model, measured, rows)
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
    return np.full(len(frame), number), frame, box, Boxes(center_m, size_lwh_m, heading_rad), velocity_mps


def _stack(
    pieces: Sequence[tuple[Array, Array, Array, Boxes, Array]], dropped: Mapping[str, list[int]]
) -> Tracks:
    if not pieces:
        none = np.zeros(0, dtype=np.int64)
        return Tracks(none, none, none, concat([], Boxes), np.zeros((0, 3)), dropped)
    number, frame, box, boxes, velocity_mps = zip(*pieces, strict=True)
    return Tracks(
        np.concatenate(number),
        np.concatenate(frame),
        np.concatenate(box),
        concat(boxes, Boxes),
        np.concatenate(velocity_mps),
        dropped,
    )
