"""Which boxes of different frames are one object: one pass through time, then fragments that belong together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class Fragments:
    """Parts of tracks, in the order of their first boxes, and the ends of their smooth paths.

    Attributes:
        first_frame: (k,) frame of the first box of each.
        last_frame: (k,) frame of its last box.
        starts_s: (k,) time of the first box.
        ends_s: (k,) time of the last box.
        fits: States and covariances of each in all its frames.
    """

    first_frame: Ints
    last_frame: Ints
    starts_s: Floats
    ends_s: Floats
    fits: Sequence[tuple[Array, Array]]

    @classmethod
    def of_rows(
        cls, measured: Measurements, fragments: Sequence[Ints], fits: Sequence[tuple[Array, Array]]
    ) -> Fragments:
        """Return the fragments with these boxes and fits."""
        first, last = (np.array([rows[k] for rows in fragments], dtype=np.int64) for k in (0, -1))
        frames = measured.frame[first], measured.frame[last]
        return cls(*frames, measured.time_of(first), measured.time_of(last), fits)

    def ends(self, end: int) -> tuple[Array, Array]:
        """Return states and covariances at the first (0) or last (-1) box of each."""
        states = np.array([fit[0][end] for fit in self.fits]).reshape(-1, 4)
        return states, np.array([fit[1][end] for fit in self.fits]).reshape(-1, 4, 4)

    def at(self, fragment: Ints, frame: Ints) -> tuple[Array, Array]:
        """Return states and covariances of some fragments, each in a frame between its ends."""
        places = list(zip(fragment.tolist(), (frame - self.first_frame[fragment]).tolist(), strict=True))
        states = np.array([self.fits[k][0][place] for k, place in places]).reshape(-1, 4)
        return states, np.array([self.fits[k][1][place] for k, place in places]).reshape(-1, 4, 4)


def join_fragments(model: MotionModel, fragments: Fragments, config: TrackerConfig) -> list[list[int]]:
    """Return the fragments of each track: one that begins within the gate of another's end belongs to it.

    Three cases: a gap in which the object moves on; a longer gap between two that stand still; and a short time in
    which both go on beside each other, as pieces of one object.

    Args:
        model: How objects move.
        fragments: The fragments.
        config: Gates, and the longest gaps.
    """
    links = [
        _links_over_gaps(model, fragments, config.max_gap_s, standing=False),
        _links_over_gaps(model, fragments, config.max_standing_gap_s, standing=True),
        _links_of_pieces(fragments, config),
    ]
    ended, begun, cost = (np.concatenate(parts) for parts in zip(*links, strict=True))
    # A pair that is linked in two ways counts at the lesser cost.
    order = np.lexsort((cost, begun, ended))
    ended, begun, cost = ended[order], begun[order], cost[order]
    is_first = np.append(True, (np.diff(ended) != 0) | (np.diff(begun) != 0))[: len(ended)]
    ended, begun = assign_pairs(ended[is_first], begun[is_first], cost[is_first])
    successor = dict(zip(ended.tolist(), begun.tolist(), strict=True))
    tracks = []
    for start in sorted(set(range(len(fragments.fits))) - set(successor.values())):
        chain = [start]
        while chain[-1] in successor:
            chain.append(successor[chain[-1]])
        tracks.append(chain)
    return tracks


def _links_over_gaps(
    model: MotionModel, fragments: Fragments, max_gap_s: float, *, standing: bool
) -> tuple[Ints, Ints, Array]:
    """Return pairs of a fragment and one that begins where it would be by then, and their squared distances."""
    config = model.config
    last, first = fragments.ends(-1), fragments.ends(0)
    none: Ints = np.zeros(0, dtype=np.int64)
    chosen = [(none, none, np.zeros(0))]
    if standing:
        model = MotionModel(replace(config, acceleration_psd_m2ps3=config.standing_psd_m2ps3))
    for ended, begun in _pairs_in_time(fragments.starts_s, fragments.ends_s, max_gap_s):
        if standing:
            stands = _speed(last[0]) < config.standing_mps, _speed(first[0]) < config.standing_mps
            both = stands[0][ended] & stands[1][begun]
            ended, begun = ended[both], begun[both]
        gap_s = fragments.starts_s[begun] - fragments.ends_s[ended]
        near = _is_near(model, last, first, ended, begun, gap_s)
        ended, begun, gap_s = ended[near], begun[near], gap_s[near]
        state, covariance = model.predict(last[0][ended], last[1][ended], gap_s)
        cost = squared_distance(first[0][begun] - state, first[1][begun] + covariance)
        within = cost <= config.gate_sigma**2
        chosen.append((ended[within], begun[within], cost[within]))
    ended, begun, cost = (np.concatenate(column) for column in zip(*chosen, strict=True))
    return ended, begun, cost


def _links_of_pieces(fragments: Fragments, config: TrackerConfig) -> tuple[Ints, Ints, Array]:
    """Return pairs of a fragment and one that begins shortly before its end, in the same place, and goes on."""
    starts_s, ends_s = fragments.starts_s, fragments.ends_s
    begin = np.searchsorted(starts_s, ends_s - config.max_overlap_s, side="right")
    end = np.searchsorted(starts_s, ends_s, side="right")
    ended, begun = _ranges(begin, end)
    goes_on = (starts_s[begun] > starts_s[ended]) & (ends_s[begun] > ends_s[ended])
    ended, begun = ended[goes_on], begun[goes_on]
    state, covariance = fragments.ends(-1)
    other, other_covariance = fragments.at(begun, fragments.last_frame[ended])
    cost = squared_distance(other - state[ended], covariance[ended] + other_covariance)
    within = cost <= config.gate_sigma**2
    return ended[within], begun[within], cost[within]


def _ranges(begin: Ints, end: Ints) -> tuple[Ints, Ints]:
    """Return the numbers from each begin up to its end, and before them the place of that begin."""
    count = np.maximum(end - begin, 0)
    place = np.repeat(np.arange(len(count)), count)
    return place, begin[place] + np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)


def _pairs_in_time(starts_s: Floats, ends_s: Floats, max_gap_s: float) -> Iterator[tuple[Ints, Ints]]:
    """Yield pairs of a fragment and one that begins after its end, but no later than the gap, some at a time."""
    begin = np.searchsorted(starts_s, ends_s, side="right")
    end = np.searchsorted(starts_s - max_gap_s, ends_s, side="right")
    part = np.cumsum(np.maximum(end - begin, 0)) // _MAX_PAIRS
    for chosen in (np.flatnonzero(part == number) for number in np.unique(part)):
        place, begun = _ranges(begin[chosen], end[chosen])
        ended = chosen[place]
        gap_s = starts_s[begun] - ends_s[ended]
        in_time = (gap_s > 0) & (gap_s <= max_gap_s)
        yield ended[in_time], begun[in_time]


def _is_near(
    model: MotionModel,
    last: tuple[Array, Array],
    first: tuple[Array, Array],
    ended: Ints,
    begun: Ints,
    gap_s: Floats,
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


def _speed(state: Floats) -> Array:
    return np.hypot(state[:, 2], state[:, 3])


def _squared_norm(offset: Floats) -> Array:
    return np.asarray(offset[..., 0] ** 2 + offset[..., 1] ** 2)


def _position_trace(covariance: Floats) -> Array:
    return np.asarray(covariance[..., 0, 0] + covariance[..., 1, 1])
