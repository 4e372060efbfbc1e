"""Rigid alignment of upright things: rotation about the vertical and translation, no scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Floats


class Alignment(NamedTuple):
    """How one cloud lies on another.

    Attributes:
        target_from_source: (4, 4) transform.
        inlier_rmse_m: Root mean square distance of the source points that have a target point within
            the radius; infinite where none has.
        inlier_share: Share of the source points that have one.
    """

    target_from_source: Floats
    inlier_rmse_m: float
    inlier_share: float


def align_yaw(
    source_xyz_m: Floats,
    target_xyz_m: Floats,
    *,
    start: Floats,
    radius_m: float,
    iterations: int,
    stop_m: float,
) -> Alignment:
    """Align two clouds by point-to-point ICP with rotation about the vertical only.

    Args:
        source_xyz_m: (n, 3) points to move.
        target_xyz_m: (m, 3) points to reach.
        start: (4, 4) first guess of target_from_source.
        radius_m: Pairs further apart than this are left out.
        iterations: Most steps to take.
        stop_m: Stop once no source point moves further than this in a step.

    Returns:
        The alignment; the start itself where fewer than three pairs were ever within the radius.

    Besl and McKay, A Method for Registration of 3-D Shapes, PAMI 1992; the closed form of a step is
    Umeyama's (PAMI 1991) with the rotation confined to one axis.
    """
    target_from_source = np.array(start, dtype=np.float64)
    if not len(source_xyz_m) or not len(target_xyz_m):
        return Alignment(target_from_source, float("inf"), 0.0)
    tree = cKDTree(target_xyz_m)
    source = np.asarray(source_xyz_m, dtype=np.float64)
    moved = apply(target_from_source, source)
    for _ in range(iterations):
        distance, nearest = tree.query(moved, distance_upper_bound=radius_m)
        paired = np.isfinite(distance)
        if paired.sum() < 3:
            break
        step = fit_yaw(moved[paired], tree.data[nearest[paired]])
        target_from_source = step @ target_from_source
        before, moved = moved, apply(target_from_source, source)
        if np.abs(moved - before).max() < stop_m:
            break
    return _judge(tree, target_from_source, moved, radius_m)


def fit_yaw(source_xyz_m: Floats, target_xyz_m: Floats) -> Floats:
    """Fit rotation about the vertical and translation to pairs of points, least squares.

    Args:
        source_xyz_m: (n, 3) points, n ≥ 1.
        target_xyz_m: (n, 3) where each of them should lie.

    Returns:
        (4, 4) target_from_source.
    """
    centre, goal = source_xyz_m.mean(axis=0), target_xyz_m.mean(axis=0)
    x, y = (source_xyz_m - centre)[:, :2].T
    u, v = (target_xyz_m - goal)[:, :2].T
    yaw = np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum())
    fit = np.eye(4)
    fit[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    fit[:3, 3] = goal - fit[:3, :3] @ centre
    return fit


def _judge(tree: cKDTree, target_from_source: Floats, moved: Floats, radius_m: float) -> Alignment:
    distance, _ = tree.query(moved, distance_upper_bound=radius_m)
    inliers = distance[np.isfinite(distance)]
    rmse_m = float(np.sqrt(np.mean(inliers**2))) if len(inliers) else float("inf")
    return Alignment(target_from_source, rmse_m, len(inliers) / len(moved))
