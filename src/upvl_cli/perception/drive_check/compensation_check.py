"""Whether the points of a turning LiDAR were moved to the frame's time: not done, done, or done twice.

A point that was measured a time t after the frame's lies at p - t u(p) in a sweep without motion compensation, where u
is the velocity of the car at that place. What stands lies at one place in two sweeps once the right share a of t u is
added: 0 where compensation is done, 1 where it is not, -1 where it is done twice or in the wrong sense. Neighbouring
sweeps see a thing under nearly the same angle, so at nearly the same t: it takes sweeps some metres apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from upvl_cli.geometry.se3 import compose, from_yaw
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.motion_config import CompensationConfig, MotionCheckConfig
from upvl_cli.perception.drive_check.motion_survey import MotionSurvey
from upvl_cli.perception.drive_check.relative_motion import agreement, refine_motion, surface_information
from upvl_cli.perception.drive_check.upright_structure import UprightStructure
from upvl_cli.types import Floats

CompensationState = Literal["done", "not done", "done twice", "cannot tell"]
_MISSING: dict[CompensationState, float] = {"done": 0.0, "not done": 1.0, "done twice": -1.0}
_SHARES = np.array(
    [-2.0, -1.0, 0.0, 1.0, 2.0]
)  # around the three that occur, so that a parabola has its top inside
_MIN_PAIRS = 3


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


class _Path:
    """The car's velocity by the sweeps, at any time."""

    def __init__(self, survey: MotionSurvey) -> None:
        pairs = sorted(survey.measured, key=lambda pair: pair.time_s)
        self._time_s = np.array([pair.time_s for pair in pairs])
        self._velocity = np.array([pair.planar.vector / pair.dt_s for pair in pairs if pair.planar])

    def velocity(self, time_s: float) -> Floats:
        """Return (3,) x, y (m/s) and yaw rate (rad/s)."""
        return np.array([np.interp(time_s, self._time_s, self._velocity[:, axis]) for axis in range(3)])

    def motion(self, first_s: float, second_s: float) -> Floats:
        """Return (3,) x, y and yaw of first_from_second."""
        steps = max(int(np.ceil((second_s - first_s) / 0.1)), 1)
        step_s = (second_s - first_s) / steps
        total = np.eye(4)
        for number in range(steps):
            x, y, yaw = self.velocity(first_s + (number + 0.5) * step_s) * step_s
            total = compose(total, from_yaw(float(yaw), np.array([x, y, 0.0])))
        return np.array([total[0, 3], total[1, 3], np.arctan2(total[1, 0], total[0, 0])])


def estimate_compensation(survey: MotionSurvey, config: MotionCheckConfig) -> Compensation:
    """Estimate how much motion compensation is missing from the sweeps of a survey.

    Args:
        survey: Structures with times of their points, and motions.
        config: Settings.
    """
    limits = config.compensation
    if len(survey.measured) < _MIN_PAIRS:
        return Compensation("cannot tell", reason="too few sweeps can be compared")
    path = _Path(survey)
    timed = [step for step, structure in survey.structures.items() if _is_timed(structure, limits)]
    if not timed:
        return Compensation("cannot tell", reason="points have no times of their own")
    moving = [
        step for step in timed if np.hypot(*path.velocity(survey.times_s[step])[:2]) > limits.min_speed_mps
    ]
    if not moving:
        reason = "the car stands or is slow in all sweeps looked at"
        return Compensation("cannot tell", reason=reason)
    pairs = _distant_pairs(moving, survey, path, limits)
    rows = [_profile(first, second, survey, path, config) for first, second in pairs]
    scores = np.array([row for row in rows if np.isfinite(row).all()]).reshape(-1, len(_SHARES))
    if len(scores) < _MIN_PAIRS:
        return Compensation("cannot tell", reason="too few sweeps a few metres apart can be compared")
    share, sigma = _top(scores)
    state = _state(share, sigma, limits)
    reason = (
        "" if state != "cannot tell" else f"missing share {share:.2f} +- {sigma:.2f} from {len(scores)} pairs"
    )
    return Compensation(state, share, sigma, len(scores), reason)


def _is_timed(structure: UprightStructure, config: CompensationConfig) -> bool:
    """Return whether points have times that spread."""
    if not len(structure):
        return False
    low, high = np.quantile(structure.offset_s, (0.05, 0.95))
    return bool(high - low > config.min_spread_s)


def _distant_pairs(
    steps: list[int], survey: MotionSurvey, path: _Path, config: CompensationConfig
) -> list[tuple[int, int]]:
    """Return pairs of steps that are about as far apart as the settings ask, spread over the drive."""
    found = []
    for first in steps:
        later = [
            step for step in steps if 0 < survey.times_s[step] - survey.times_s[first] < config.max_gap_s
        ]
        if not later:
            continue
        off = [
            abs(np.hypot(*path.motion(survey.times_s[first], survey.times_s[step])[:2]) - config.distance_m)
            for step in later
        ]
        if min(off) < 0.4 * config.distance_m:
            found.append((first, later[int(np.argmin(off))]))
    if not found:
        return []
    chosen = np.unique(np.linspace(0, len(found) - 1, config.pairs).round().astype(int))
    return [found[number] for number in chosen]


def _profile(first: int, second: int, survey: MotionSurvey, path: _Path, config: MotionCheckConfig) -> Floats:
    """Return how well two sweeps agree at their best, for each share of compensation that is added; NaN for none."""
    guess = path.motion(survey.times_s[first], survey.times_s[second])
    scores = np.full(len(_SHARES), np.nan)
    for place, share in enumerate(_SHARES):
        source, target = (
            _compensate(survey.structures[step], path.velocity(survey.times_s[step]), float(share))
            for step in (second, first)
        )
        surfaces = surface_information(target, config.registration)
        found = refine_motion(source, target, surfaces, guess, config.registration)
        if found is not None:
            scores[place] = agreement(source, target, surfaces, found.vector, config.registration)
    return scores


def _compensate(structure: UprightStructure, velocity: Floats, share: float) -> UprightStructure:
    """Return a structure with a share of the motion compensation added."""
    moved = structure.xyz_m.copy()
    time_s = share * structure.offset_s
    moved[:, 0] += time_s * (velocity[0] - velocity[2] * structure.xyz_m[:, 1])
    moved[:, 1] += time_s * (velocity[1] + velocity[2] * structure.xyz_m[:, 0])
    return UprightStructure(moved, structure.offset_s)


def _top(scores: Floats) -> tuple[float, float]:
    """Return the share at the top of the parabola through the mean score, and its deviation by jackknife over pairs."""
    total = scores.sum(axis=0)
    count = len(scores)
    without = np.array([_vertex(total - row) for row in scores])
    sigma = float(np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum()))
    return _vertex(total), max(sigma, 0.05)


def _vertex(scores: Floats) -> float:
    """Return where the parabola through scores has its top; infinite where it has none."""
    square, slope, _ = np.polyfit(_SHARES, scores, 2)
    return float(-slope / (2 * square)) if square < 0 else np.inf


def _state(share: float, sigma: float, config: CompensationConfig) -> CompensationState:
    """Return the state nearest to the share, where it is near and no other is possible."""
    if not np.isfinite(share) or not np.isfinite(sigma):
        return "cannot tell"
    states = sorted(_MISSING, key=lambda state: abs(share - _MISSING[state]))
    nearest, second = (abs(share - _MISSING[state]) for state in states[:2])
    is_clear = nearest < config.tolerance and second > config.sigmas * sigma
    return states[0] if is_clear else "cannot tell"


def check_compensation(found: Compensation) -> Iterator[Finding]:
    """Yield what the sweeps say of their motion compensation.

    Args:
        found: The estimate.
    """
    subject = "motion compensation"
    evidence = (
        f"missing share {found.missing_share:.2f} +- {found.sigma:.2f} from {found.pairs} pairs of sweeps"
    )
    if found.state == "cannot tell":
        yield Finding(subject, "cannot tell", found.reason)
    elif found.state == "done":
        yield Finding(subject, "ok", "points are where they were at the frame's time", "", evidence)
    elif found.state == "not done":
        words = "not done: points are where the turning LiDAR saw them"
        remedy = "compensate the sweeps, or give poses, so that the reader can"
        yield Finding(subject, "warning", words, "", evidence, "raw sweeps of a moving car", remedy)
    else:
        words = "done twice, or in the wrong sense"
        cause = "sweeps that were compensated before, or times of points with the wrong sign"
        remedy = "give raw sweeps, or times of points of zero"
        yield Finding(subject, "warning", words, "", evidence, cause, remedy)
