"""The plain script that labels are measured against: a short pipeline of well-known parts, without upvl's methods.

Ground by Patchwork++ (pypatchworkpp; upvl's own where it is not installed), DBSCAN on 0.2 m voxels (scikit-learn),
rigid ICP of each cluster on the next sweep, a Kalman filter (filterpy) with the Hungarian method (SciPy) for tracks,
one size a track (a high percentile of what was seen). What stands is scored by the product of points seen, length of
the track and how plausible its size is for a road user. `bench/labels.py` runs it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.optimize import linear_sum_assignment

from plain_clusters import Cluster, clusters_of, machine, pypatchworkpp, standing
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Drive, TrackedBoxes

GATE_M, MOST_MISSED, LEAST_FRAMES = 2.5, 3, 3
MOVING_MPS, LEAST_WAY_M = 1.0, 1.5
SIZE_PERCENTILE = 92.0
WIDEST_M = 3.2  # of what drives
CAR_M = (4.5, 1.8)  # what drives and is wider than a rider is no smaller


@dataclass
class Track:
    """A filter and the clusters that it took, by place of their frame."""

    filter: Any
    number: int
    seen: dict[int, Cluster] = field(default_factory=dict)
    missed: int = 0


def labels(
    drive: Drive, world_from_ego: np.ndarray, is_ground: dict[int, np.ndarray]
) -> dict[str, dict[int, TrackedBoxes]]:
    """Return the boxes of each frame, of moving objects and of all.

    Args:
        drive: The sweeps.
        world_from_ego: (T, 4, 4) poses.
        is_ground: By frame, what is ground where Patchwork++ is not installed.
    """
    time_s = np.array([frame.time_ns for frame in drive.frames]) / 1e9
    patchwork = machine() if pypatchworkpp is not None else None
    sweeps = [
        standing(patchwork, drive, drive.points(frame.index), is_ground.get(frame.index), pose)
        for frame, pose in zip(drive.frames, world_from_ego, strict=True)
    ]
    clusters = []
    for place, (xyz, beneath) in enumerate(sweeps):
        other = place + 1 if place + 1 < len(sweeps) else place - 1
        dt = time_s[other] - time_s[place] if len(sweeps) > 1 else 1.0
        clusters.append(clusters_of(xyz, beneath, sweeps[other][0] if len(sweeps) > 1 else xyz, dt))
    return _labels_of(clusters, drive, world_from_ego, time_s)


def _labels_of(
    clusters: list[list[Cluster]], drive: Drive, world_from_ego: np.ndarray, time_s: np.ndarray
) -> dict[str, dict[int, TrackedBoxes]]:
    """Return the boxes that the tracks of clusters make."""
    tracks = [track for track in _tracks(clusters, time_s) if len(track.seen) >= LEAST_FRAMES]
    found: dict[str, dict[int, list[tuple[Any, ...]]]] = {
        mode: {frame.index: [] for frame in drive.frames} for mode in ("moving", "all")
    }
    for track in tracks:
        moves, rows = _boxes(track, world_from_ego, time_s)
        for place, row in rows:
            index = drive.frames[place].index
            found["all"][index].append(row)
            if moves:
                found["moving"][index].append(row)
    return {mode: {index: _tracked(rows) for index, rows in frames.items()} for mode, frames in found.items()}


def _tracks(clusters: list[list[Cluster]], time_s: np.ndarray) -> list[Track]:
    alive: list[Track] = []
    done: list[Track] = []
    for place, here in enumerate(clusters):
        dt = time_s[place] - time_s[place - 1] if place else 0.1
        for track in alive:
            track.filter.F[:2, 2:] = np.eye(2) * dt
            track.filter.Q = np.diag([0.05, 0.05, 1.0, 1.0]) * max(dt, 0.01)
            track.filter.predict()
        middle = np.array([_middle(one.xyz_m) for one in here]).reshape(-1, 3)[:, :2]
        cost = np.array([np.linalg.norm(middle - track.filter.x[:2], axis=1) for track in alive])
        cost = cost.reshape(len(alive), len(here))
        taken = set()
        for row, column in zip(*linear_sum_assignment(np.minimum(cost, 1e3)), strict=True):
            if cost[row, column] < GATE_M:
                alive[row].filter.update(np.append(middle[column], here[column].velocity_mps[:2]))
                alive[row].seen[place], alive[row].missed = here[column], -1
                taken.add(column)
        for track in alive:
            track.missed += 1
        done += [track for track in alive if track.missed > MOST_MISSED]
        alive = [track for track in alive if track.missed <= MOST_MISSED]
        for column in set(range(len(here))) - taken:
            fresh = Track(_filter(middle[column], here[column].velocity_mps), len(done) + len(alive))
            fresh.seen[place] = here[column]
            alive.append(fresh)
    return [*done, *alive]


def _filter(middle: np.ndarray, velocity: np.ndarray) -> Any:
    made = KalmanFilter(dim_x=4, dim_z=4)
    made.x = np.append(middle, velocity[:2])
    made.H, made.F = np.eye(4), np.eye(4)
    made.P, made.R = np.diag([0.2, 0.2, 2.0, 2.0]), np.diag([0.1, 0.1, 1.0, 1.0])
    return made


def _middle(xyz: np.ndarray) -> np.ndarray:
    return np.asarray((xyz.min(axis=0) + xyz.max(axis=0)) / 2)


@dataclass(frozen=True)
class Travel:
    """How a track goes.

    Attributes:
        middles_m: (n, 3) mean of its points in each of its frames.
        speed_mps: Length of its mean velocity by ICP.
        moves: Whether it goes anywhere.
        agreement: From 0 to 1, how steadily it goes, and how well both ways of measuring agree.
    """

    middles_m: np.ndarray
    speed_mps: float
    moves: bool
    agreement: float


def _travel(clusters: list[Cluster], time_s: np.ndarray) -> Travel:
    """Tell how a track goes: a mover goes where both its middles and its surfaces go, and in one direction."""
    middles = np.array([one.xyz_m.mean(axis=0) for one in clusters])
    velocities = np.array([one.velocity_mps[:2] for one in clusters])
    mean = velocities.mean(axis=0)
    speed = float(np.linalg.norm(mean))
    along = float((middles[-1, :2] - middles[0, :2]) @ mean) / max(speed, 1e-9)
    coherence = speed / max(float(np.linalg.norm(velocities, axis=1).mean()), 1e-9)
    steps = np.diff(middles[:, :2], axis=0) / np.maximum(np.diff(time_s), 1e-3)[:, None]
    off = float(np.median(np.linalg.norm(steps - velocities[:-1], axis=1))) / (0.5 + speed)
    moves = along > max(LEAST_WAY_M, 0.7 * float(time_s[-1] - time_s[0])) and speed > 0.8 * MOVING_MPS
    return Travel(middles, speed, moves and coherence > 0.6 and off < 0.6, coherence * float(np.exp(-off)))


def _boxes(
    track: Track, poses: np.ndarray, time_s: np.ndarray
) -> tuple[bool, list[tuple[int, tuple[Any, ...]]]]:
    """Whether a track moves, and its boxes by place of their frame, in ego axes."""
    places = sorted(track.seen)
    clusters = [track.seen[place] for place in places]
    travel = _travel(clusters, time_s[places])
    middles, headings, seen = travel.middles_m, [], []
    for at, one in enumerate(clusters):
        span = middles[min(at + 2, len(places) - 1)] - middles[max(at - 2, 0)]
        heading = np.arctan2(span[1], span[0]) if travel.moves else _rectangle(one.xyz_m[:, :2])
        headings.append(heading)
        seen.append(_extent(one.xyz_m, heading))
    low, high = (np.array([box[side] for box in seen]) for side in (0, 1))
    size = np.percentile(high - low, SIZE_PERCENTILE, axis=0)
    moves = travel.moves and size[1] < WIDEST_M
    if moves and size[1] < CAR_M[1]:  # of walkers and riders single points make too much
        size[1] = np.median((high - low)[:, 1])
    if moves and size[1] > 1.1 and travel.speed_mps > 2.5:
        size[:2] = np.maximum(size[:2], CAR_M)
    score = _score(track, size, moves, travel.agreement)
    floor = np.array([one.ground_m for one in clusters])
    size[2] = np.percentile(high[:, 2] - floor, SIZE_PERCENTILE)
    size = np.maximum(size, 0.3)
    rows = []
    for at, place in enumerate(places):
        pose = poses[place]
        before, after = max(at - 1, 0), min(at + 1, len(places) - 1)
        took_s = max(time_s[places[after]] - time_s[places[before]], 1e-3)
        velocity = (middles[after] - middles[before]) / took_s if moves else np.zeros(3)
        centre = _whole(low[at, :2], high[at, :2], size[:2], headings[at], pose[:2, 3])
        local = apply(inverse(pose), np.array([[*centre, floor[at] + size[2] / 2]]))[0]
        yaw = headings[at] - np.arctan2(pose[1, 0], pose[0, 0])
        rows.append((place, (local, size, yaw, velocity @ pose[:3, :3], score, track.number)))
    return bool(moves), rows


def _whole(
    low: np.ndarray, high: np.ndarray, size: np.ndarray, heading: float, sensor: np.ndarray
) -> np.ndarray:
    """World place of the middle: the corner nearest to the sensor stays, and what is missing lies behind."""
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, -sin], [sin, cos]])
    here = sensor @ turn
    nearer_low = np.abs(low - here) < np.abs(high - here)
    return np.asarray(np.where(nearer_low, low + size / 2, high - size / 2) @ turn.T)


def _extent(xyz: np.ndarray, heading: float) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest along the heading, across it and upwards."""
    cos, sin = np.cos(heading), np.sin(heading)
    turned = np.column_stack([xyz[:, :2] @ np.array([[cos, -sin], [sin, cos]]), xyz[:, 2]])
    return np.percentile(turned, 2, axis=0), np.percentile(turned, 98, axis=0)


def _rectangle(xy: np.ndarray) -> float:
    """Direction of the long side of the smallest rectangle."""
    angles = np.deg2rad(np.arange(0, 90, 3.0))
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    along, across = (
        np.ptp(xy @ ways.T, axis=0),
        np.ptp(xy @ np.column_stack([-ways[:, 1], ways[:, 0]]).T, axis=0),
    )
    best = int(np.argmin(along * across))
    return float(angles[best] + (np.pi / 2 if across[best] > along[best] else 0.0))


def _score(track: Track, size: np.ndarray, moves: bool, agreement: float) -> float:
    """Points seen times length of the track, and for what stands times how plausible its size is."""
    points = np.median([len(one.xyz_m) for one in track.seen.values()])
    grown = (1 - np.exp(-points / 60)) * (1 - np.exp(-len(track.seen) / 6))
    if moves:
        return float(0.5 + 0.5 * grown * agreement)
    length, width, height = size
    car = np.exp(-(((length - 4.2) / 1.6) ** 2) - ((width - 1.7) / 0.7) ** 2 - ((height - 1.3) / 0.5) ** 2)
    walker = np.exp(-(((length - 0.7) / 0.5) ** 2) - ((width - 0.5) / 0.4) ** 2 - ((height - 1.4) / 0.4) ** 2)
    return float(0.5 * grown * max(car, 0.7 * walker, 0.05))


def _tracked(rows: list[tuple[Any, ...]]) -> TrackedBoxes:
    if not rows:
        return TrackedBoxes(*(np.zeros(0) for _ in range(6)))
    return TrackedBoxes(*(np.array(values) for values in zip(*rows, strict=True)))
