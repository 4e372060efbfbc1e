"""Whether the points of a turning LiDAR were moved to the frame's time: not done, done, or done twice.

A point that was measured a time t after the frame's lies at p - t u(p) in a sweep without motion compensation, where u
is the velocity of the car at that place. What stands must lie at the same place in two sweeps; the share a of t u that
has to be added so that it does is estimated together with the motion: 0 where compensation is done, 1 where it is
not, -1 where it is done twice (or in the wrong sense).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from upvl_cli.geometry.se3 import apply, from_yaw
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.motion_config import CompensationConfig, MotionCheckConfig
from upvl_cli.perception.drive_check.motion_survey import MeasuredPair, MotionSurvey
from upvl_cli.perception.drive_check.relative_motion import SurfaceMatch, match_surfaces, surface_information
from upvl_cli.perception.drive_check.upright_structure import UprightStructure
from upvl_cli.types import Floats

CompensationState = Literal["done", "not done", "done twice", "cannot tell"]
_VALUE: dict[CompensationState, float] = {"done": 0.0, "not done": 1.0, "done twice": -1.0}


@dataclass(frozen=True)
class Compensation:
    """How much motion compensation is missing.

    Attributes:
        state: What that means.
        missing_share: Share that is missing: 0 done, 1 not done, -1 done twice.
        sigma: Its standard deviation.
        pairs: Pairs of sweeps that it was estimated from.
        reason: Why it cannot be told; empty where it can.
    """

    state: CompensationState
    missing_share: float = 0.0
    sigma: float = np.inf
    pairs: int = 0
    reason: str = ""


def estimate_compensation(survey: MotionSurvey, config: MotionCheckConfig) -> Compensation:
    """Estimate how much motion compensation is missing from the sweeps of a survey.

    Args:
        survey: Structures with times of their points, and motions.
        config: Settings.
    """
    limits = config.compensation
    moving = [pair for pair in survey.measured if _speed_mps(pair) > limits.min_speed_mps]
    if not moving:
        return Compensation("cannot tell", reason="the car stands or drives slowly in all sweeps looked at")
    timed = [pair for pair in moving if _is_timed(survey.structures[pair.first], pair.dt_s, limits)]
    if not timed:
        return Compensation("cannot tell", reason="points have no times of their own")
    share = 0.0
    for _ in range(limits.iterations):
        found = [_missing(pair, survey, share, config) for pair in timed]
        known = np.array([row for row in found if row is not None]).reshape(-1, 2)
        if not len(known):
            return Compensation("cannot tell", reason="too little stands beside the road")
        step, sigma = _pool(known)
        share += step
    state = _state(share, sigma, limits)
    reason = "" if state != "cannot tell" else f"missing share {share:.2f} +- {sigma:.2f}"
    return Compensation(state, share, sigma, len(known), reason)


def _speed_mps(pair: MeasuredPair) -> float:
    return float(np.hypot(*pair.planar.vector[:2])) / pair.dt_s if pair.planar else 0.0


def _is_timed(structure: UprightStructure, dt_s: float, config: CompensationConfig) -> bool:
    """Return whether points have times that spread over a part of the time between sweeps."""
    if not len(structure):
        return False
    low, high = np.quantile(structure.offset_s, (0.05, 0.95))
    return bool(high - low > config.min_spread_share * min(dt_s, 0.1))


def _pool(rows: Floats) -> tuple[float, float]:
    """Return the weighted mean of rows of value and standard deviation, and its own, widened where they disagree."""
    weight = 1 / np.maximum(rows[:, 1], 0.02) ** 2
    center = np.median(rows[:, 0])
    weight = np.where(np.abs(rows[:, 0] - center) < 4 * rows[:, 1] + 0.2, weight, 0.0)
    mean = float((weight * rows[:, 0]).sum() / weight.sum())
    spread = float((weight**2 * (rows[:, 0] - mean) ** 2).sum()) / float(weight.sum()) ** 2
    return mean, float(np.sqrt(max(spread, 1 / weight.sum())))


def _state(share: float, sigma: float, config: CompensationConfig) -> CompensationState:
    """Return the state that the share fits, where it fits no other."""
    fitting = [
        state for state, value in _VALUE.items() if abs(share - value) < config.sigmas * sigma + config.tolerance
    ]
    return fitting[0] if len(fitting) == 1 else "cannot tell"


def _missing(
    pair: MeasuredPair, survey: MotionSurvey, share: float, config: MotionCheckConfig
) -> tuple[float, float] | None:
    """Return what is missing beyond a share that is added already, and its standard deviation, by one pair."""
    assert pair.planar is not None
    vector = pair.planar.vector
    twist = vector / pair.dt_s
    source, target = (
        _compensate(survey.structures[step], twist, share) for step in (pair.second, pair.first)
    )
    surfaces = surface_information(target, config.registration)
    sectors = config.registration.sectors
    for _ in range(config.compensation.iterations):
        match = match_surfaces(source, target, surfaces, vector, config.registration.radius_m[-1])
        if len(match.row) < 10 * sectors:
            return None
        hessian, gradient = _normal_equations(match, source, target, vector, twist, sectors)
        solution = np.linalg.lstsq(hessian.sum(axis=0), gradient.sum(axis=0), rcond=None)[0]
        vector = vector + solution[:3]
    total_h, total_g = hessian.sum(axis=0), gradient.sum(axis=0)
    if np.linalg.cond(total_h) > 1e10:
        return None
    without = np.array([
        np.linalg.lstsq(total_h - part_h, total_g - part_g, rcond=None)[0][3]
        for part_h, part_g in zip(hessian, gradient, strict=True)
    ])  # fmt: skip
    sigma = float(np.sqrt((sectors - 1) / sectors * ((without - without.mean()) ** 2).sum()))
    return float(solution[3]), sigma


def _compensate(structure: UprightStructure, twist: Floats, share: float) -> UprightStructure:
    """Return a structure with a share of the motion compensation added."""
    moved = structure.xyz_m.copy()
    moved[:, :2] += share * structure.offset_s[:, None] * _velocity(structure.xyz_m, twist)
    return UprightStructure(moved, structure.offset_s)


def _velocity(xyz_m: Floats, twist: Floats) -> Floats:
    """Return the (n, 2) velocity of the car at each place."""
    return np.stack([twist[0] - twist[2] * xyz_m[:, 1], twist[1] + twist[2] * xyz_m[:, 0]], axis=1)


def _normal_equations(
    match: SurfaceMatch,
    source: UprightStructure,
    target: UprightStructure,
    vector: Floats,
    twist: Floats,
    sectors: int,
) -> tuple[Floats, Floats]:
    """Return (sectors, 4, 4) and (sectors, 4) of x, y, yaw and the missing share."""
    turn = from_yaw(float(vector[2]), np.zeros(3))
    of_source, of_target = (
        part.offset_s[rows, None] * _velocity(part.xyz_m[rows], twist)
        for part, rows in ((source, match.row), (target, match.partner))
    )
    turned = apply(turn, np.column_stack([of_source, np.zeros(len(of_source))]))[:, :2]
    lever = match.moved_m - (vector[0], vector[1], 0.0)
    design = np.zeros((len(match.row), 2, 4))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -lever[:, 1], lever[:, 0]
    design[:, :, 3] = turned - of_target
    xx, xy, yy = (match.weight[:, None] * match.surface).T
    weighted = np.stack(
        [
            xx[:, None] * design[:, 0] + xy[:, None] * design[:, 1],
            xy[:, None] * design[:, 0] + yy[:, None] * design[:, 1],
        ],
        axis=1,
    )
    angle = np.arctan2(lever[:, 1], lever[:, 0]) / (2 * np.pi) + 0.5
    sector = np.minimum((angle * sectors).astype(np.int64), sectors - 1)
    hessian, gradient = np.zeros((sectors, 4, 4)), np.zeros((sectors, 4))
    for row in range(4):
        values = weighted[:, 0, row] * match.gap_m[:, 0] + weighted[:, 1, row] * match.gap_m[:, 1]
        gradient[:, row] = np.bincount(sector, weights=values, minlength=sectors)
        for column in range(4):
            values = weighted[:, 0, row] * design[:, 0, column] + weighted[:, 1, row] * design[:, 1, column]
            hessian[:, row, column] = np.bincount(sector, weights=values, minlength=sectors)
    return hessian, gradient


def check_compensation(found: Compensation, *, has_poses: bool) -> Iterator[Finding]:
    """Yield what the sweeps say of their motion compensation.

    Args:
        found: The estimate.
        has_poses: Whether a reader could move the points by poses.
    """
    subject = "motion compensation"
    evidence = f"missing share {found.missing_share:.2f} +- {found.sigma:.2f} from {found.pairs} pairs of sweeps"
    if found.state == "cannot tell":
        yield Finding(subject, "cannot tell", found.reason)
    elif found.state == "done":
        yield Finding(subject, "ok", "points are where they were at the frame's time", "", evidence)
    elif found.state == "not done":
        words = "not done: points are where the turning LiDAR saw them"
        cause = "raw sweeps" if has_poses else "raw sweeps, and no poses to move the points by"
        remedy = "compensate the sweeps before, or give the times of the points where the reader asks for them"
        yield Finding(subject, "warning", words, "", evidence, cause, remedy)
    else:
        words = "done twice, or in the wrong sense"
        cause = "sweeps that were compensated already, or times of points with the wrong sign"
        yield Finding(subject, "warning", words, "", evidence, cause, "say that the sweeps are compensated already")


def all_states() -> Sequence[CompensationState]:
    """Return the states in which a drive can be."""
    return ("done", "not done", "done twice", "cannot tell")
