"""From sweeps to clusters, for the plain script of `plain_labels.py`: ground, DBSCAN, and rigid ICP of each cluster."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from sklearn.cluster import DBSCAN

from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Drive, Points

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


class Cluster(NamedTuple):
    """What stands apart in one sweep, in world axes; `ground_m` is how high the ground below it lies."""

    xyz_m: np.ndarray
    velocity_mps: np.ndarray
    ground_m: float


def standing(
    patchwork: Any, drive: Drive, points: Points, ground: np.ndarray | None, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """World places of what stands above the ground, and how high the ground is below each.

    `ground` is used where there is no `patchwork`.
    """
    near = np.hypot(*points.xyz_ego_m[:, :2].T) < REACH_M
    near &= np.isfinite(points.xyz_ego_m).all(axis=1)
    xyz = points.xyz_ego_m[near].astype(np.float64)
    if patchwork is not None:
        ground = _patchwork(patchwork, xyz, points.intensity[near], drive.ground_z_m)
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


def machine() -> Any:
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


def _patchwork(patchwork: Any, xyz: np.ndarray, intensity: np.ndarray, ground_z_m: float) -> np.ndarray:
    lowered = xyz - [0, 0, ground_z_m + SENSOR_M]
    patchwork.estimateGround(np.column_stack([lowered, intensity]).astype(np.float32))
    ground = np.zeros(len(xyz), dtype=bool)
    ground[np.asarray(patchwork.getGroundIndices(), dtype=np.int64)] = True
    return ground


def _voxels(xyz: np.ndarray, size_m: float) -> np.ndarray:
    """Mean place in each voxel."""
    _, owner = np.unique(np.floor(xyz / size_m).astype(np.int64), axis=0, return_inverse=True)
    owner = owner.ravel()
    count = np.bincount(owner)
    return np.column_stack([np.bincount(owner, weights=xyz[:, axis]) / count for axis in range(3)])


def clusters_of(xyz: np.ndarray, beneath: np.ndarray, following: np.ndarray, dt: float) -> list[Cluster]:
    """Clusters of a sweep, each with its velocity by the sweep that follows after `dt`."""
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
