"""Tracks of moving objects through one segment, from the boxes of its sweeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.tracking.assignment import assign
from upvl_cli.perception.tracking.motion_model import MotionModel, squared_distance, update
from upvl_cli.types import Array, Floats, Ints

NONE = -1


@dataclass(frozen=True)
class Tracks:
    """Tracked boxes in world axes, one row a track and frame, sorted by track and then frame.

    Attributes:
        track: (n,) number of the track, from 0 on in the order of first sight.
        frame: (n,) number of the frame.
        box: (n,) row of the box among those that were tracked; -1 where the track only coasts.
        seven: (n, 7) the box; where coasting the typical size at the expected place.
        velocity_mps: (n, 3) velocity from the whole track; z as measured.
        dropped: How many tracks were left out, by reason.
    """

    track: Ints
    frame: Ints
    box: Ints
    seven: Array
    velocity_mps: Array
    dropped: dict[str, int]


@dataclass
class _Alive:
    """A track while the frames go by: its boxes, and the filter's state at the last of them."""

    state: Array
    spread: Array
    rows: list[int]
    time_s: float


def track(
    frame: Ints,
    seven: Floats,
    velocity_mps: Floats,
    time_s: Floats,
    *,
    agility_m2ps3: float,
    position_noise_m: float,
    velocity_noise_mps: float,
    gate: float,
    max_coast_s: float,
    max_gap_s: float,
    min_boxes: int,
    min_reach_m: float,
    min_follow: float,
) -> Tracks:
    """Join the boxes of all frames to tracks, forget those that go nowhere, and fill their gaps.

    Args:
        frame: (n,) number of the frame of each box, ascending.
        seven: (n, 7) boxes in world axes.
        velocity_mps: (n, 3) their velocities in world axes.
        time_s: (T,) ascending time of each frame.
        agility_m2ps3: Spectral density of the acceleration: a velocity wanders by the root of this times the time.
        position_noise_m: Standard deviation of the centre of a small box.
        velocity_noise_mps: Standard deviation of a box's velocity.
        gate: Standard deviations (position and velocity together) within which a box can be the track's.
        max_coast_s: A track ends when it has had no box for longer than this.
        max_gap_s: The end of one track and the start of another this much later can be one object.
        min_boxes: A track with fewer boxes is dropped.
        min_reach_m: A track is dropped whose velocities never take it further than this.
        min_follow: So is one whose boxes move on by less than this share of what the velocities claim:
            1 is perfect, 0 stands still. Both 0 (and less) keep what stands still, for every motion state.
    """
    model = MotionModel(agility_m2ps3, position_noise_m, velocity_noise_mps)
    measured = np.hstack([seven[:, :2], velocity_mps[:, :2]])
    noise = model.noise(seven)
    chains = _follow(model, frame, measured, noise, time_s, gate**2, max_coast_s)
    fits = [_fit(model, rows, frame, measured, noise, time_s) for rows in chains]
    chains = _join(model, chains, fits, frame, time_s, gate**2, max_gap_s)
    dropped = {"too few boxes": 0, "goes nowhere": 0}
    rows_of_tracks = []
    for rows in chains:
        if len(rows) < min_boxes:
            dropped["too few boxes"] += 1
        elif not _gets_away(measured[rows], time_s[frame[rows]], min_reach_m, min_follow):
            dropped["goes nowhere"] += 1
        else:
            rows_of_tracks.append(rows)
    pieces = [
        _rows(number, rows, frame, seven, velocity_mps, _fit(model, rows, frame, measured, noise, time_s)[0])
        for number, rows in enumerate(rows_of_tracks)
    ]
    return _stack(pieces, dropped)


def _follow(
    model: MotionModel,
    frame: Ints,
    measured: Array,
    noise: Array,
    time_s: Floats,
    gate: float,
    max_coast_s: float,
) -> list[Ints]:
    """The boxes of each track by one pass through time, in order of first box."""
    tracks: list[_Alive] = []
    for now in np.unique(frame):
        rows = np.flatnonzero(frame == now)
        alive = [one for one in tracks if time_s[now] - one.time_s <= max_coast_s]
        expected = [model.predict(one.state, one.spread, time_s[now] - one.time_s) for one in alive]
        states = np.array([state for state, _ in expected]).reshape(-1, 4)
        spreads = np.array([spread for _, spread in expected]).reshape(-1, 4, 4)
        cost = squared_distance(measured[rows] - states[:, None], spreads[:, None] + noise[rows])
        old, new = assign(np.where(cost <= gate, cost, np.inf))
        for i, row in zip(old, rows[new], strict=True):
            one = alive[i]
            one.state, one.spread = update(*expected[i], measured[row], noise[row])
            one.rows.append(int(row))
            one.time_s = float(time_s[now])
        for row in np.delete(rows, new):
            tracks.append(_Alive(measured[row], noise[row], [int(row)], float(time_s[now])))
    return [np.array(one.rows) for one in tracks]


def _fit(
    model: MotionModel, rows: Ints, frame: Ints, measured: Array, noise: Array, time_s: Floats
) -> tuple[Array, Array]:
    """States and covariances of one track in all frames from its first to its last."""
    at = frame[rows] - frame[rows[0]]
    seen = np.full((at[-1] + 1, 4), np.nan)
    blur = np.zeros((at[-1] + 1, 4, 4))
    seen[at], blur[at] = measured[rows], noise[rows]
    return model.filter(time_s[frame[rows[0]] : frame[rows[-1]] + 1], seen, blur)


def _join(
    model: MotionModel,
    chains: list[Ints],
    fits: list[tuple[Array, Array]],
    frame: Ints,
    time_s: Floats,
    gate: float,
    max_gap_s: float,
) -> list[Ints]:
    """Tracks whose end foretells the start of another are one."""
    cost = np.full((len(chains), len(chains)), np.inf)
    starts_s = np.array([time_s[frame[rows[0]]] for rows in chains])
    for i, (rows, (states, spreads)) in enumerate(zip(chains, fits, strict=True)):
        gap_s = starts_s - time_s[frame[rows[-1]]]
        for j in np.flatnonzero((gap_s > 0) & (gap_s <= max_gap_s)):
            state, spread = model.predict(states[-1], spreads[-1], gap_s[j])
            cost[i, j] = squared_distance(fits[j][0][0] - state, fits[j][1][0] + spread)
    follower = dict(zip(*assign(np.where(cost <= gate, cost, np.inf)), strict=True))
    joined = []
    for first in sorted(set(range(len(chains))) - set(follower.values())):
        links = [first]
        while links[-1] in follower:
            links.append(follower[links[-1]])
        joined.append(np.concatenate([chains[link] for link in links]))
    return joined


def _gets_away(measured: Array, time_s: Floats, min_reach_m: float, min_follow: float) -> bool:
    """Whether the velocities of a track take it somewhere, and its boxes follow them there."""
    steps = np.diff(time_s)[:, None] * (measured[1:, 2:] + measured[:-1, 2:]) / 2
    claimed = np.vstack([np.zeros(2), steps.cumsum(axis=0)])
    reach = np.linalg.norm(claimed - claimed[0], axis=1).max()
    claimed = claimed - claimed.mean(axis=0)
    shown = measured[:, :2] - measured[:, :2].mean(axis=0)
    # Slope of the least squares line of the places over the claimed ones: 1 for any path truly taken.
    follow = (shown * claimed).sum() / max((claimed**2).sum(), np.finfo(float).tiny)
    return bool(reach >= min_reach_m and follow >= min_follow)


def _rows(
    number: int, rows: Ints, frame: Ints, seven: Floats, velocity_mps: Floats, states: Array
) -> tuple[Array, ...]:
    """One track as columns: frame, box, seven, velocity; its gaps filled."""
    frames = np.arange(frame[rows[0]], frame[rows[-1]] + 1)
    at = frame[rows] - frame[rows[0]]
    box = np.full(len(frames), NONE, dtype=np.int64)
    box[at] = rows
    filled = np.empty((len(frames), 7))
    filled[:, :2] = states[:, :2]
    for column in (2, 5):
        filled[:, column] = np.interp(frames, frame[rows], seven[rows, column])
    filled[:, 3:5] = np.median(seven[rows, 3:5], axis=0)
    filled[:, 6] = np.arctan2(states[:, 3], states[:, 2])
    filled[at] = seven[rows]
    vertical = np.interp(frames, frame[rows], velocity_mps[rows, 2])
    return np.full(len(frames), number), frames, box, filled, np.column_stack([states[:, 2:], vertical])


def _stack(pieces: list[tuple[Array, ...]], dropped: dict[str, int]) -> Tracks:
    empty = (np.zeros(0, int), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 7)), np.zeros((0, 3)))
    track, frame, box, seven, velocity = (
        np.concatenate(column) for column in zip(empty, *pieces, strict=True)
    )
    return Tracks(track, frame, box, seven, velocity, dropped)
