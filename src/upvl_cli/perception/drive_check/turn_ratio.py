"""How much the sweeps turn for each radian that the poses turn: 1 where all is right, -1 where a side is mirrored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.se3 import yaw_of
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.perception.drive_check.pose_hypotheses import PosePairs

_MIN_PAIRS = 6


@dataclass(frozen=True)
class TurnRatio:
    """Turn by the sweeps over turn by the poses.

    Attributes:
        value: The ratio.
        sigma: Its standard deviation.
    """

    value: float
    sigma: float

    def cause(self, limits: MotionLimitsConfig) -> str:
        """Return what a ratio that is not 1 means, in words; empty where it may be 1."""
        if abs(self.value - 1) < limits.sigmas * self.sigma:
            return ""
        if abs(self.value + 1) < 0.3 and self.value < -limits.sigmas * self.sigma:
            return "left and right are swapped in the poses or in the points, or yaw is measured clockwise"
        degrees = 180 / np.pi
        for factor, words in ((degrees, "radians where degrees"), (1 / degrees, "degrees where radians")):
            if 0.7 < self.value / factor < 1.4 and self.value > limits.sigmas * self.sigma:
                return f"yaw of the poses is in {words} are expected"
        return ""


def estimate_turn_ratio(pairs: PosePairs) -> TurnRatio | None:
    """Return the ratio, by least squares over all pairs without outliers; None where too few are known."""
    measured, given = yaw_of(pairs.measured), yaw_of(pairs.given)
    kept = np.isfinite(given)
    for _ in range(3):
        power = float((given[kept] ** 2).sum())
        if kept.sum() < _MIN_PAIRS or power <= 0:
            return None
        value = float((measured[kept] * given[kept]).sum()) / power
        residual = measured - value * given
        scatter = 1.48 * float(np.median(np.abs(residual[kept]))) + float(np.median(pairs.sigma_rad)) + 1e-5
        kept = np.isfinite(given) & (np.abs(residual) < 4 * scatter)
    return TurnRatio(value, scatter / np.sqrt(power))
