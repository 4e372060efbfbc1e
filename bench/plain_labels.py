"""The plain script that labels are measured against: a short pipeline of well-known parts, without upvl's methods.

Ground by Patchwork++ (pypatchworkpp; upvl's own where it is not installed), DBSCAN on 0.2 m voxels (scikit-learn),
rigid ICP of each cluster on the next sweep, a Kalman filter (filterpy) with the Hungarian method (SciPy) for tracks,
one size a track (a high percentile of what was seen). What stands is scored by the product of points seen, length of
the track and how plausible its size is for a road user. `bench/labels.py` runs it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN

from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Drive, Points, TrackedBoxes

try:
    import pypatchworkpp
except ImportError:
    pypatchworkpp = None

REACH_M = 100.0
VOXEL_M, EPS_M, MIN_VOXELS, MIN_POINTS = 0.2, 1.0, 3, 6
LOWEST_M, HIGHEST_M = 0.25, 4.5  # above the ground: kerbs below, crowns above
SENSOR_M = 1.73
FASTEST_MPS = 30.0
ICP_STEPS, ICP_POINTS, ICP_M = 10, 150, 1.0
WORSE_M, CLEARLY = 0.1, 0.7  # other starts are tried above this residual, and must be so much better
GATE_M, MOST_MISSED, LEAST_FRAMES = 2.5, 3, 3
MOVING_MPS, LEAST_WAY_M = 1.0, 1.5
SIZE_PERCENTILE = 92.0
WIDEST_M = 3.2  # of what drives
CAR_M = (4.5, 1.8)  # what drives and is wider than a rider is no smaller


class Cluster(NamedTuple):
    """What stands apart in one sweep, in world axes but for `ground_m`."""

    xyz_m: np.ndarray
    velocity_mps: np.ndarray
    ground_m: float


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
    machine = _machine() if pypatchworkpp is not None else None
    sweeps = [
        _standing(machine, drive, drive.points(frame.index), is_ground.get(frame.index), pose)
        for frame, pose in zip(drive.frames, world_from_ego, strict=True)
    ]
    clusters = []
    for place, (xyz, beneath) in enumerate(sweeps):
        other = place + 1 if place + 1 < len(sweeps) else place - 1
        dt = time_s[other] - time_s[place] if len(sweeps) > 1 else 1.0
        clusters.append(_clusters(xyz, beneath, sweeps[other][0] if len(sweeps) > 1 else xyz, dt))
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


def _standing(
    machine: Any, drive: Drive, points: Points, ground: np.ndarray | None, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World places of what stands above the ground, and how high the ground is below each."""
    near = np.hypot(*points.xyz_ego_m[:, :2].T) < REACH_M
    near &= np.isfinite(points.xyz_ego_m).all(axis=1)
    xyz = points.xyz_ego_m[near].astype(np.float64)
    if machine is not None:
        ground = _patchwork(machine, xyz, points.intensity[near], drive.ground_z_m)
    else:
        assert ground is not None
        ground = ground[near]
    floor = _voxels(
        xyz[ground], 0.5
    )  # of the voxels around, a low one: what a kerb or a bonnet adds is no ground
    if not len(floor):
        return np.zeros((0, 3)), np.zeros(0)
    above = xyz[~ground]
    _, nearest = cKDTree(floor[:, :2]).query(above[:, :2], k=min(8, len(floor)))
    beneath = floor[nearest.reshape(len(above), -1), 2].min(axis=1)
    height = above[:, 2] - beneath
    kept = (height > LOWEST_M) & (height < HIGHEST_M)
    lifted = np.column_stack([above[kept, :2], beneath[kept]])
    return apply(pose, above[kept]), apply(pose, lifted)[:, 2]


def _machine() -> Any:
    """Patchwork++, which greets on the terminal when it is made; it adapts from sweep to sweep of one drive."""
    settings = pypatchworkpp.Parameters()
    settings.sensor_height, settings.verbose, settings.enable_RNR = SENSOR_M, False, False
    settings.min_range, settings.max_range = 1.0, REACH_M
    terminal = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            return pypatchworkpp.patchworkpp(settings)
        finally:
            os.dup2(terminal, 1)
            os.close(terminal)


def _patchwork(machine: Any, xyz: np.ndarray, intensity: np.ndarray, ground_z_m: float) -> np.ndarray:
    lowered = xyz - [0, 0, ground_z_m + SENSOR_M]
    machine.estimateGround(np.column_stack([lowered, intensity]).astype(np.float32))
    ground = np.zeros(len(xyz), dtype=bool)
    ground[np.asarray(machine.getGroundIndices(), dtype=np.int64)] = True
    return ground


def _voxels(xyz: np.ndarray, size_m: float) -> np.ndarray:
    """Mean place in each voxel."""
    _, owner = np.unique(np.floor(xyz / size_m).astype(np.int64), axis=0, return_inverse=True)
    owner = owner.ravel()
    count = np.bincount(owner)
    return np.column_stack([np.bincount(owner, weights=xyz[:, axis]) / count for axis in range(3)])


def _clusters(xyz: np.ndarray, beneath: np.ndarray, following: np.ndarray, dt: float) -> list[Cluster]:
    if not len(xyz):
        return []
    keys, owner = np.unique(np.floor(xyz / VOXEL_M).astype(np.int64), axis=0, return_inverse=True)
    label = DBSCAN(eps=EPS_M, min_samples=MIN_VOXELS).fit(keys * VOXEL_M).labels_[owner.ravel()]
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(label.max() + 2))
    tree = cKDTree(following) if len(following) else None
    found = []
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        mine = order[first:last]
        size = np.ptp(xyz[mine], axis=0)
        if len(mine) < MIN_POINTS or size.max() > 25 or size[2] < 0.3:
            continue
        velocity = _icp(xyz[mine], tree, dt) if tree is not None else np.zeros(3)
        found.append(Cluster(xyz[mine], velocity, float(np.median(beneath[mine]))))
    return found


def _icp(cluster: np.ndarray, tree: cKDTree, dt: float) -> np.ndarray:
    """Velocity of the cluster's middle: the best of a few starts of ICP with a turn about the vertical."""
    step = max(1, len(cluster) // ICP_POINTS)
    xyz = cluster[::step]
    middle = xyz.mean(axis=0)
    reach = min(FASTEST_MPS * abs(dt), 6.0)
    around = tree.data[tree.query_ball_point(middle, reach + 2.0)]
    best, shift = _converged(xyz, tree)
    if best > WORSE_M and len(around) and len(xyz) > 15:
        local = np.linspace(-reach, reach, 9)
        grid = np.array([(x, y, 0.0) for x in local for y in local if np.hypot(x, y) <= reach])
        for start in grid[np.argsort([_residual(xyz + start, tree) for start in grid])[:2]]:
            residual, moved = _converged(xyz + start, tree)
            if residual < CLEARLY * best:
                best, shift = residual, moved + start
    return shift / dt


def _converged(xyz: np.ndarray, tree: cKDTree) -> tuple[float, np.ndarray]:
    """Residual after ICP, and how far the middle went."""
    moved = xyz
    for _ in range(ICP_STEPS):
        off, nearest = tree.query(moved, distance_upper_bound=ICP_M)
        met = np.isfinite(off)
        if met.sum() < 6:
            break
        moved = _aligned(moved, moved[met], tree.data[nearest[met]])
    return _residual(moved, tree), moved.mean(axis=0) - xyz.mean(axis=0)


def _residual(xyz: np.ndarray, tree: cKDTree) -> float:
    return float(np.minimum(tree.query(xyz, distance_upper_bound=ICP_M)[0], ICP_M).mean())


def _aligned(xyz: np.ndarray, source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Turn about the vertical and shift so that the source meets the target best."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    p, q = source - a, target - b
    yaw = np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p[:, :2] * q[:, :2]).sum())
    cos, sin = np.cos(yaw), np.sin(yaw)
    away = xyz - a
    turned = np.column_stack(
        [cos * away[:, 0] - sin * away[:, 1], sin * away[:, 0] + cos * away[:, 1], away[:, 2]]
    )
    return np.asarray(turned + b)


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


def _boxes(
    track: Track, poses: np.ndarray, time_s: np.ndarray
) -> tuple[bool, list[tuple[int, tuple[Any, ...]]]]:
    """Whether a track moves, and its boxes by place of their frame, in ego axes."""
    places = sorted(track.seen)
    middles = np.array([track.seen[place].xyz_m.mean(axis=0) for place in places])
    velocities = np.array([track.seen[place].velocity_mps[:2] for place in places])
    took_s = max(float(time_s[places[-1]] - time_s[places[0]]), 1e-3)
    # A mover goes where both its middles and its surfaces go, and in one direction.
    mean = velocities.mean(axis=0)
    way = middles[-1, :2] - middles[0, :2]
    along = float(way @ mean) / max(float(np.linalg.norm(mean)), 1e-9)
    coherence = np.linalg.norm(mean) / max(float(np.linalg.norm(velocities, axis=1).mean()), 1e-9)
    # How well the two ways of measuring agree from sweep to sweep.
    steps = np.diff(middles[:, :2], axis=0) / np.maximum(np.diff(time_s[places]), 1e-3)[:, None]
    off = np.linalg.norm(steps - velocities[:-1], axis=1)
    disagreement = float(np.median(off)) / (0.5 + float(np.linalg.norm(mean)))
    moves = along > max(LEAST_WAY_M, 0.7 * took_s) and np.linalg.norm(mean) > 0.8 * MOVING_MPS
    moves = moves and coherence > 0.6 and disagreement < 0.6
    headings, seen = [], []
    for at, place in enumerate(places):
        span = middles[min(at + 2, len(places) - 1)] - middles[max(at - 2, 0)]
        xyz = track.seen[place].xyz_m
        heading = np.arctan2(span[1], span[0]) if moves else _rectangle(xyz[:, :2])
        headings.append(heading)
        seen.append(_extent(xyz, heading))
    low, high = (np.array([box[side] for box in seen]) for side in (0, 1))
    size = np.percentile(high - low, SIZE_PERCENTILE, axis=0)
    moves = moves and size[1] < WIDEST_M
    if moves and size[1] < CAR_M[1]:  # of walkers and riders single points make too much
        size[1] = np.median((high - low)[:, 1])
    if moves and size[1] > 1.1 and np.linalg.norm(mean) > 2.5:
        size[:2] = np.maximum(size[:2], CAR_M)
    feet = np.array([track.seen[place].ground_m for place in places])
    height = max(float(np.percentile(high[:, 2] - feet, SIZE_PERCENTILE)), 0.3)
    score = _score(track, size, moves, float(coherence) * np.exp(-disagreement))
    rows = []
    for at, place in enumerate(places):
        pose = poses[place]
        cos, sin = np.cos(headings[at]), np.sin(headings[at])
        turn = np.array([[cos, -sin], [sin, cos]])
        sensor = pose[:2, 3] @ turn
        # The nearest corner stays: what is missing lies behind.
        whole = np.maximum(size[:2], 0.3)
        nearer_low = np.abs(low[at, :2] - sensor) < np.abs(high[at, :2] - sensor)
        centre = np.where(nearer_low, low[at, :2] + whole / 2, high[at, :2] - whole / 2) @ turn.T
        local = apply(inverse(pose), np.array([[*centre, feet[at] + height / 2]]))[0]
        velocity = np.zeros(3)
        if moves:
            before, after = max(at - 1, 0), min(at + 1, len(places) - 1)
            velocity = (middles[after] - middles[before]) / max(
                time_s[places[after]] - time_s[places[before]], 1e-3
            )
        yaw = headings[at] - np.arctan2(pose[1, 0], pose[0, 0])
        rows.append((place, (local, [*whole, height], yaw, velocity @ pose[:3, :3], score, track.number)))
    return bool(moves), rows


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
