"""Which boxes of different frames are one object: one pass through time, then fragments that belong together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from upvl_cli.perception.tracking.assignment import assign_pairs
from upvl_cli.perception.tracking.config import TrackerConfig
from upvl_cli.perception.tracking.measurements import Measurements
from upvl_cli.perception.tracking.motion_model import MotionModel, squared_distance, update
from upvl_cli.types import Array, Floats, Ints

_MAX_PAIRS = 10**6  # pairs of fragments that are compared at a time: some 50 MB
_ROUNDING = 1 + 1e-9  # spare room of the coarse gate, far above rounding


def associate(model: MotionModel, measured: Measurements, boxes: Ints, config: TrackerConfig) -> list[Ints]:
    """Return the boxes of each track by one pass through time, in the order of their first boxes.

    Args:
        model: How objects move.
        measured: All boxes.
        boxes: Rows of those to track, ascending.
        config: Gate, and how long a track waits for its next box.
    """
    tracks: list[list[int]] = []
    number: Ints = np.zeros(0, dtype=np.int64)  # of the tracks that wait for a box
    state, covariance, last_s = np.zeros((0, 4)), np.zeros((0, 4, 4)), np.zeros(0)
    frames = measured.frame[boxes]
    for frame in np.unique(frames):
        rows = boxes[slice(*np.searchsorted(frames, [frame, frame + 1]))]
        time_s = float(measured.time_s[frame])
        waits = time_s - last_s <= config.max_coast_s
        number, last_s = number[waits], last_s[waits]
        moved, moved_covariance = model.predict(state[waits], covariance[waits], time_s - last_s)
        measured_here, noise_here = measured.state[rows], measured.noise[rows]
        pairs = _gated_pairs(moved, moved_covariance, measured_here, noise_here, config.gate_sigma)
        place, column = assign_pairs(*pairs)
        # A track that found no box keeps the state at its last one.
        state, covariance = state[waits], covariance[waits]
        state[place], covariance[place] = update(
            moved[place], moved_covariance[place], measured_here[column], noise_here[column]
        )
        last_s[place] = time_s
        for track, row in zip(number[place].tolist(), rows[column].tolist(), strict=True):
            tracks[track].append(row)
        is_new = np.ones(len(rows), dtype=np.bool_)
        is_new[column] = False
        number = np.append(number, np.arange(len(tracks), len(tracks) + is_new.sum()))
        state = np.concatenate([state, measured_here[is_new]])
        covariance = np.concatenate([covariance, noise_here[is_new]])
        last_s = np.append(last_s, np.full(is_new.sum(), time_s))
        tracks.extend([row] for row in rows[is_new].tolist())
    return [np.array(rows) for rows in tracks]


def _gated_pairs(
    state: Floats, covariance: Floats, measured: Floats, noise: Floats, gate_sigma: float
) -> tuple[Ints, Ints, Array]:
    """Return the pairs of a predicted state and a measurement within the gate, and their squared distances.

    Pairs too far apart are left out first: the squared Mahalanobis distance of two states is no less than that
    of their positions alone, and that no less than the squared distance over the trace of the covariance.
    """
    apart_m2 = _squared_norm(measured[:, :2] - state[:, None, :2])
    limit_m2 = _position_trace(covariance)[:, None] + _position_trace(noise)
    place, column = np.nonzero(apart_m2 <= gate_sigma**2 * _ROUNDING * limit_m2)
    cost = squared_distance(measured[column] - state[place], covariance[place] + noise[column])
    within = cost <= gate_sigma**2
    return place[within], column[within], cost[within]


def join_fragments(
    model: MotionModel,
    measured: Measurements,
    fragments: Sequence[Ints],
    fits: Sequence[tuple[Array, Array]],
    config: TrackerConfig,
) -> list[list[int]]:
    """Return the fragments of each track: one that begins within the gate of another's end belongs to it.

    Args:
        model: How objects move.
        measured: All boxes.
        fragments: The boxes of each fragment, in the order of their first boxes.
        fits: States and covariances of each in all its frames.
        config: Gate, and the longest gap.
    """
    if not fragments:
        return []
    starts_s, ends_s = (measured.time_of(np.array([rows[k] for rows in fragments])) for k in (0, -1))
    first, last = ([np.array([fit[part][k] for fit in fits]) for part in (0, 1)] for k in (0, -1))
    pairs = []
    for ended, begun in _pairs_in_time(starts_s, ends_s, config.max_gap_s):
        gap_s = starts_s[begun] - ends_s[ended]
        near = _is_near(model, last, first, ended, begun, gap_s)
        ended, begun, gap_s = ended[near], begun[near], gap_s[near]
        state, covariance = model.predict(last[0][ended], last[1][ended], gap_s)
        cost = squared_distance(first[0][begun] - state, first[1][begun] + covariance)
        within = cost <= config.gate_sigma**2
        pairs.append((ended[within], begun[within], cost[within]))
    columns = [np.concatenate(parts) for parts in zip(*pairs, strict=True)]
    ended, begun = assign_pairs(columns[0], columns[1], columns[2]) if pairs else (starts_s[:0], starts_s[:0])
    successor = dict(zip(ended.tolist(), begun.tolist(), strict=True))
    tracks = []
    for start in sorted(set(range(len(fragments))) - set(successor.values())):
        links = [start]
        while links[-1] in successor:
            links.append(successor[links[-1]])
        tracks.append(links)
    return tracks


def _pairs_in_time(starts_s: Floats, ends_s: Floats, max_gap_s: float) -> Iterator[tuple[Ints, Ints]]:
    """Yield pairs of a fragment and one that begins after its end, but no later than the gap, some at a time."""
    begin = np.searchsorted(starts_s, ends_s, side="right")
    end = np.searchsorted(starts_s - max_gap_s, ends_s, side="right")
    count = np.maximum(end - begin, 0)
    part = np.cumsum(count) // _MAX_PAIRS
    for chosen in (np.flatnonzero(part == number) for number in np.unique(part)):
        ended = np.repeat(chosen, count[chosen])
        offset = np.arange(len(ended)) - np.repeat(np.cumsum(count[chosen]) - count[chosen], count[chosen])
        begun = begin[ended] + offset
        gap_s = starts_s[begun] - ends_s[ended]
        in_time = (gap_s > 0) & (gap_s <= max_gap_s)
        yield ended[in_time], begun[in_time]


def _is_near(
    model: MotionModel, last: list[Array], first: list[Array], ended: Ints, begun: Ints, gap_s: Floats
) -> Array:
    """Return whether each pair of fragments can be within the gate, by positions alone: see `_gated_pairs`."""
    state, covariance = last
    moved = state[ended, :2] + gap_s[:, None] * state[ended, 2:]
    drift = 2 * model.config.acceleration_psd_m2ps3 * gap_s**3 / 3
    cross = covariance[:, 0, 2] + covariance[:, 1, 3]
    speed = covariance[:, 2, 2] + covariance[:, 3, 3]
    trace = _position_trace(covariance)[ended] + 2 * gap_s * cross[ended] + gap_s**2 * speed[ended] + drift
    limit = model.config.gate_sigma**2 * _ROUNDING * (trace + _position_trace(first[1])[begun])
    return np.asarray(_squared_norm(first[0][begun, :2] - moved) <= limit)


def _squared_norm(offset: Floats) -> Array:
    return np.asarray(offset[..., 0] ** 2 + offset[..., 1] ** 2)


def _position_trace(covariance: Floats) -> Array:
    return np.asarray(covariance[..., 0, 0] + covariance[..., 1, 1])
