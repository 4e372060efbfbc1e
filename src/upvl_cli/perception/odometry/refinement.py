"""Refinement of given poses: steps from odometry, and the shape over long times from the given poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from upvl_cli.perception.odometry.config import RefinementConfig
from upvl_cli.types import Array, Floats

_ROUNDS = 10  # of reweighted least squares: it has converged by then
_OUTLIER = 2.0  # residuals from so many standard deviations on lose their weight (Geman and McClure)
_MIN_SCALE = 1e-6  # m or rad: poses that agree to the last digit have no outliers
_MEDOID_POSES = 200  # poses among which the typical rotation is looked for


class Refinement(NamedTuple):
    """Refined poses.

    Attributes:
        world_from_ego: (T, 4, 4) poses in the axes of the given ones.
        agrees: Whether the given poses have the shape that the sweeps show; else they gave the axes alone.
    """

    world_from_ego: Array
    agrees: bool


def refine_poses(given: Array, estimated: Array, time_s: Floats, config: RefinementConfig) -> Refinement:
    """Correct an estimated path by a slow drift so that it follows given poses, which are rough but do not drift.

    Rotations first, then the positions of the path that the turned steps make: in both, what is given less what is
    estimated is fitted by a function of time that bends slowly (a smoothing spline, Wahba, 1990), with outliers left
    out by reweighting.

    Args:
        given: (T, 4, 4) world_from_ego as the drive has them.
        estimated: (T, 4, 4) poses by odometry, in any axes.
        time_s: (T,) their times, ascending.
        config: Over which time errors of the given poses are averaged, and how fast odometry drifts at most.
    """
    if len(given) < 2:
        return Refinement(np.array(given), True)
    turns = Rotation.from_matrix(given[:, :3, :3]) * Rotation.from_matrix(estimated[:, :3, :3]).inv()
    typical = _medoid(turns)
    spread_rad = (typical.inv() * turns).as_rotvec()
    slow_rad = fit_slowly(spread_rad, time_s, config.averaging_s)
    world_from_start = typical * Rotation.from_rotvec(slow_rad)
    path_m = _path(world_from_start.as_matrix(), estimated)
    offset_m = given[:, :3, 3] - path_m
    slow_m = fit_slowly(offset_m, time_s, config.averaging_s)
    agrees = _is_drift(slow_m, path_m, time_s, config) and _is_turn_drift(slow_rad, time_s, config)
    if not agrees:
        world_from_start = Rotation.concatenate([typical] * len(given))
        path_m = _path(world_from_start.as_matrix(), estimated)
        slow_m = np.broadcast_to(np.median(given[:1, :3, 3] - path_m[:1], axis=0), path_m.shape)
    poses = np.array(given, dtype=np.float64)
    poses[:, :3, :3] = (world_from_start * Rotation.from_matrix(estimated[:, :3, :3])).as_matrix()
    poses[:, :3, 3] = path_m + slow_m
    return Refinement(poses, agrees)


def fit_slowly(values: Floats, time_s: Floats, averaging_s: float) -> Floats:
    """Return (T, d) a slowly bending function of time through (T, d) values, without their outliers.

    Minimises the integral of |f - values|^2 + averaging_s^4 |f''|^2 by the penalty on second divided differences,
    with the weights of Geman and McClure for the distances.

    Args:
        values: (T, d) values.
        time_s: (T,) their times, ascending.
        averaging_s: Time over which values are averaged.
    """
    total = len(values)
    if total < 3:
        return np.broadcast_to(np.median(values, axis=0), values.shape).copy()
    steps_s = np.diff(time_s)
    duration_s = np.zeros(total)
    duration_s[:-1] += steps_s / 2
    duration_s[1:] += steps_s / 2
    bands = averaging_s**4 * _bending(steps_s)
    weight = np.ones(total)
    fitted = values
    for _ in range(_ROUNDS):
        system = bands.copy()
        system[0] += weight * duration_s
        fitted = solveh_banded(system, (weight * duration_s)[:, None] * values, lower=True)
        distance = np.linalg.norm(values - fitted, axis=1)
        scale = max(1.4826 * float(np.median(distance)), _MIN_SCALE)
        weight = 1 / (1 + (distance / (_OUTLIER * scale)) ** 2) ** 2
    return np.asarray(fitted)


def _bending(steps_s: Floats) -> Floats:
    """(3, T) lower bands of the penalty: the sum over inner frames of |second divided difference|^2 times its time."""
    total = len(steps_s) + 1
    before, after = steps_s[:-1], steps_s[1:]
    length = (before + after) / 2
    rows = np.stack([1 / (before * length), -(1 / before + 1 / after) / length, 1 / (after * length)])
    bands = np.zeros((3, total))
    for i in range(3):
        for j in range(i, 3):
            bands[j - i, i : i + total - 2] += rows[i] * rows[j] * length
    return bands


def _path(world_from_start: Floats, estimated: Floats) -> Floats:
    """Return (T, 3) positions of the estimated steps, each turned by the (T, 3, 3) rotation at its time."""
    steps = np.diff(estimated[:, :3, 3], axis=0)
    turned = (world_from_start[:-1] * steps[:, None, :]).sum(axis=2)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(turned, axis=0)])


def _medoid(turns: Rotation) -> Rotation:
    """Return the rotation that the others are nearest to: no average, so that outliers do not count."""
    chosen = turns[np.unique(np.linspace(0, len(turns) - 1, _MEDOID_POSES).astype(int))]
    distance = [float(np.median((each.inv() * chosen).magnitude())) for each in chosen]
    return chosen[int(np.argmin(distance))]


def _is_drift(slow_m: Floats, path_m: Floats, time_s: Floats, config: RefinementConfig) -> bool:
    """Whether the slow correction of positions is one that odometry's drift needs."""
    seconds = time_s[-1] - time_s[0]
    moved_m = np.linalg.norm(np.diff(slow_m, axis=0), axis=1).sum()
    length_m = np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum()
    return bool(moved_m <= config.max_drift_share * length_m + config.max_drift_mps * seconds)


def _is_turn_drift(slow_rad: Floats, time_s: Floats, config: RefinementConfig) -> bool:
    """Whether the slow correction of rotations is one that odometry's drift needs."""
    turned_rad = np.linalg.norm(np.diff(slow_rad, axis=0), axis=1).sum()
    return bool(turned_rad <= config.max_turn_drift_radps * (time_s[-1] - time_s[0]))
