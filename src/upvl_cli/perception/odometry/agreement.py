"""How well two sweeps agree under a motion: partners, distances along normals, and what they leave open."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.se3 import apply, compose, from_yaw, inverse
from upvl_cli.perception.odometry.config import AgreementConfig
from upvl_cli.types import Array, Floats, Ints

# Rings of a LiDAR with few beams are metres apart on a wall: a partner may lie higher or lower than it may lie aside.
_Z_SCALE = 0.1
_NEIGHBORS = 4  # points whose mean is the place of the surface
_NORMAL_CELL_M = 1.0  # noise of 2 cm turns the normal of so long a piece of wall by a degree
_MIN_PAIRS = 20  # fewer say nothing of three numbers
_MIN_SIGMA_M = 0.01  # noise of a LiDAR's range that no residual goes below
_STEPS = 8  # of Gauss-Newton at most
_CONVERGED_M = 0.002  # a fifth of what the fit leaves open
_LEVER_M = 20.0  # a turn counts by how far it moves points at this distance
_ABREAST = 10.0  # neighboring points share their error: so many count as one; an assumption, not measured


class Structure:
    """The upright points of a sweep, motion-compensated, and a tree over them."""

    def __init__(self, xyz_m: Floats) -> None:
        """Take (n, 3) points in ego axes."""
        self.xyz_m = xyz_m

    def __len__(self) -> int:
        return len(self.xyz_m)

    @cached_property
    def tree(self) -> cKDTree:
        """Tree over the points, heights scaled down."""
        return cKDTree(_scaled(self.xyz_m))

    @cached_property
    def normals(self) -> Floats:
        """(n, 2) horizontal normal of the surface at each point: across the most variance in its cell of the plan."""
        xy = self.xyz_m[:, :2]
        _, cell = np.unique(np.floor(xy / _NORMAL_CELL_M).astype(np.int64) @ [2**20, 1], return_inverse=True)
        weight = np.bincount(cell)
        center = np.stack([np.bincount(cell, weights=axis) / weight for axis in xy.T], axis=1)
        x, y = (xy - center[cell]).T
        xx, yy, cross = (np.bincount(cell, weights=each) for each in (x * x, y * y, x * y))
        angle = 0.5 * np.arctan2(2 * cross, xx - yy) + np.pi / 2
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)[cell]


@dataclass(frozen=True)
class Agreement:
    """How well a sweep fits the one before under a motion.

    Attributes:
        inlier_share: Share of the points with a partner within the radius, mean of both directions; NaN where there
            are too few points to say.
        squares_m2: Mean squared distance of the partners along the normal, n the partners; NaN without.
        gradient: (3,) its half derivative by a small motion in x (m), y (m) and yaw (rad) of the target's axes.
        hessian: (3, 3) half its second derivative.
        pairs: n, how many partners there are.
    """

    inlier_share: float
    squares_m2: float
    gradient: Floats
    hessian: Floats
    pairs: int

    @property
    def is_measured(self) -> bool:
        """Whether there was enough to measure."""
        return self.pairs >= _MIN_PAIRS

    def rmse_m(self, motion: Floats | None = None) -> float:
        """Return the root mean square distance after a further small motion, by the second-order model.

        Args:
            motion: (3,) x (m), y (m) and yaw (rad) in the target's axes; None for none.
        """
        if not self.is_measured:
            return float("nan")
        squares = self.squares_m2
        if motion is not None:
            squares += float(2 * self.gradient @ motion + motion @ self.hessian @ motion)
        return float(np.sqrt(max(squares, 0.0)))

    def error_m2(self, radius_m: float) -> float:
        """Return the mean squared distance, where a point without a partner counts as one at the radius."""
        if not self.is_measured:
            return radius_m**2
        return (1 - self.inlier_share) * radius_m**2 + self.inlier_share * self.squares_m2

    @property
    def sigmas(self) -> tuple[float, float]:
        """Standard deviations of the motion's position (m, its worst direction) and yaw (rad); infinite unmeasured."""
        if not self.is_measured:
            return float("inf"), float("inf")
        noise_m2 = max(self.squares_m2, _MIN_SIGMA_M**2) * _ABREAST / self.pairs
        covariance = noise_m2 * np.linalg.inv(self.hessian + 1e-9 * np.eye(3))
        return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])), float(np.sqrt(covariance[2, 2]))


def measure_agreement(
    target: Structure, source: Structure, target_from_source: Array, config: AgreementConfig
) -> Agreement:
    """Compare two sweeps under a motion: point to plane, in the ground plan.

    Args:
        target: The sweep before.
        source: The sweep.
        target_from_source: (4, 4) the motion between them.
        config: Radius and how many points are compared.
    """
    if len(target) < _NEIGHBORS or len(source) < _NEIGHBORS:
        return Agreement(float("nan"), float("nan"), np.zeros(3), np.zeros((3, 3)), 0)
    moved = apply(target_from_source, _sample(source.xyz_m, config.points))
    distance, nearest = target.tree.query(_scaled(moved), k=_NEIGHBORS)
    back = apply(inverse(target_from_source), _sample(target.xyz_m, config.points))
    back_distance = source.tree.query(_scaled(back))[0]
    paired = distance[:, 0] <= config.partner_m
    share = float((paired.mean() + (back_distance <= config.partner_m).mean()) / 2)
    if paired.sum() < _MIN_PAIRS:
        return Agreement(share, float("nan"), np.zeros(3), np.zeros((3, 3)), 0)
    return _fit(moved[paired, :2], target, nearest[paired], share)


def align_structure(
    target: Structure,
    source: Structure,
    target_from_source: Array,
    config: AgreementConfig,
    guess_sigma_m: float,
) -> Array:
    """Return the motion under which two sweeps agree best: Gauss-Newton over x, y and yaw, point to plane.

    Chen and Medioni, Object modelling by registration of multiple range images, 1992. The road takes no part: its
    rings pull every motion towards none while a map holds few sweeps.

    Args:
        target: The sweep before.
        source: The sweep.
        target_from_source: (4, 4) first guess of the motion between them.
        config: Radius and how many points are compared.
        guess_sigma_m: Standard deviation of the guess, which takes part as a measurement.
    """
    motion = target_from_source
    if len(target) < _NEIGHBORS or len(source) < _NEIGHBORS:
        return motion
    points, total = _sample(source.xyz_m, config.points), np.zeros(3)
    for _ in range(_STEPS):
        moved = apply(motion, points)
        distance, nearest = target.tree.query(_scaled(moved), k=_NEIGHBORS)
        paired = distance[:, 0] <= config.partner_m
        if paired.sum() < _MIN_PAIRS:
            break
        fit = _fit(moved[paired, :2], target, nearest[paired], 1.0)
        prior = np.diag([1.0, 1.0, _LEVER_M**2]) / guess_sigma_m**2 * fit.squares_m2 * _ABREAST / fit.pairs
        step = -np.linalg.solve(fit.hessian + prior, fit.gradient + prior @ total)
        total = total + step
        motion = compose(from_yaw(step[2], np.array([step[0], step[1], 0.0])), motion)
        if np.abs(step * [1.0, 1.0, _LEVER_M]).max() < _CONVERGED_M:
            break
    return motion


def _fit(xy_m: Floats, target: Structure, nearest: Ints, share: float) -> Agreement:
    """Return the least-squares model of distances from points (n, 2) to the lines through (n, k) target points."""
    anchor, normal = target.xyz_m[nearest, :2].mean(axis=1), target.normals[nearest[:, 0]]
    away = ((xy_m - anchor) * normal).sum(axis=1)
    lever = xy_m[:, 0] * normal[:, 1] - xy_m[:, 1] * normal[:, 0]
    columns = np.column_stack([normal, lever])
    total = len(away)
    gradient = (columns * away[:, None]).sum(axis=0) / total
    hessian = (columns[:, :, None] * columns[:, None, :]).sum(axis=0) / total
    return Agreement(share, float((away**2).mean()), gradient, hessian, total)


def _scaled(xyz_m: Floats) -> Floats:
    return np.asarray(xyz_m * [1.0, 1.0, _Z_SCALE])


def _sample(xyz_m: Floats, most: int) -> Floats:
    """Return at most so many of the points, evenly taken."""
    return np.asarray(xyz_m[:: max(-(-len(xyz_m) // most), 1)])
