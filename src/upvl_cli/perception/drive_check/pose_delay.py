"""A constant delay of poses against sweeps, small enough that they still agree: visible where speed or turn change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.se3 import compose, inverse, yaw_of
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.perception.drive_check.pose_hypotheses import PosePairs
from upvl_cli.types import Array, Floats

_MIN_PAIRS = 8
_ROUNDS = 5


@dataclass(frozen=True)
class PoseDelay:
    """How late poses are.

    Attributes:
        seconds: The delay; negative where they are early.
        sigma_s: Its standard deviation.
    """

    seconds: float
    sigma_s: float

    def is_clear(self, limits: MotionLimitsConfig) -> bool:
        """Whether the delay is certain and matters."""
        return abs(self.seconds) > max(limits.sigmas * self.sigma_s, limits.min_delay_s)


def estimate_delay(pairs: PosePairs, limits: MotionLimitsConfig) -> PoseDelay | None:
    """Return the delay that brings the poses nearest to the sweeps; None where these do not show one.

    Gauss-Newton on x, y and yaw of all pairs, each weighted by its own scatter; pairs far off are left out.

    Args:
        pairs: Poses and measured motions.
        limits: Longest delay.
    """
    if len(pairs) < _MIN_PAIRS or len(pairs.times_ns) < _MIN_PAIRS:
        return None
    delay_s, sigma_s, step_s = 0.0, np.inf, 0.0
    half_s = float(np.median(pairs.dt_s)) / 2
    for _ in range(_ROUNDS):
        error = _errors(pairs.after(delay_s), pairs)
        slope = (
            _errors(pairs.after(delay_s + half_s), pairs) - _errors(pairs.after(delay_s - half_s), pairs)
        ) / (2 * half_s)
        center = np.median(error, axis=0)
        scatter = 1.48 * np.median(np.abs(error - center), axis=0) + np.array([1e-3, 1e-3, 1e-5])
        weight = (np.abs(error) < 4 * scatter + np.abs(center)) / scatter**2
        information = float((weight * slope**2).sum())
        if information <= 0:
            return None
        step_s = float((weight * slope * error).sum()) / information
        delay_s -= step_s
        sigma_s = _spread(weight * slope * error, pairs) / information
        if abs(delay_s) > limits.max_delay_s:
            return None
    if abs(step_s) > 0.01:  # not converged: no minimum that counts
        return None
    return PoseDelay(delay_s, sigma_s) if limits.sigmas * sigma_s < limits.max_delay_s else None


def _spread(terms: Floats, pairs: PosePairs) -> float:
    """Return the standard deviation of a sum of terms, those of neighbouring pairs taken together.

    Errors of positions are in one step and, with the other sign, in the next one.
    """
    new_run = np.append(0, np.cumsum(pairs.first[1:] != pairs.second[:-1]))
    sums = np.bincount(new_run, weights=terms.sum(axis=1))
    count = len(sums)
    return float(np.sqrt(count / (count - 1) * ((sums - sums.mean()) ** 2).sum())) if count > 2 else np.inf


def _errors(motions: Array, pairs: PosePairs) -> Floats:
    """Return (p, 3) x, y and yaw of claimed against measured motions."""
    error = compose(inverse(pairs.measured), motions)
    return np.column_stack([error[:, 0, 3], error[:, 1, 3], yaw_of(error)])
