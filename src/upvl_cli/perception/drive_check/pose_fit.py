"""How well motions that are claimed agree with motions that were measured between sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.perception.drive_check.pose_hypotheses import PoseHypothesis, PosePairs
from upvl_cli.types import Array, Bools, Floats

# A planar motion says little of height, roll and pitch: these may be off by more.
_HEIGHT_TOLERANCE = 3.0
_TILT_RAD, _TILT_RATE_RADPS = 0.03, 0.3
_WORST = 3.0  # a pair that is off by more tolerances counts as off by these: outliers decide nothing


@dataclass(frozen=True)
class PoseFit:
    """Agreement of claimed motions with measured ones.

    Attributes:
        error: (p,) error in tolerances: up to 1 is agreement.
        offset_m: (p, 3) claimed minus measured translation, along the ego axes of the later sweep.
        yaw_rad: (p,) claimed minus measured yaw.
        scale: What the claimed translations were multiplied by first.
    """

    error: Floats
    offset_m: Floats
    yaw_rad: Floats
    scale: float = 1.0

    @property
    def agrees(self) -> Bools:
        """(p,) whether each pair agrees."""
        return np.asarray(self.error <= 1)

    @property
    def share(self) -> float:
        """Share of pairs that agree."""
        return float(self.agrees.mean()) if len(self.error) else 0.0

    @property
    def cost(self) -> float:
        """Mean squared error, in tolerances, cut off for outliers."""
        return float((np.minimum(self.error, _WORST) ** 2).mean()) if len(self.error) else np.inf


def fit_motions(
    motions: Array, pairs: PosePairs, limits: MotionLimitsConfig, *, scale: float = 1.0
) -> PoseFit:
    """Compare claimed with measured motions.

    Args:
        motions: (p, 4, 4) claimed first_from_second.
        pairs: The measured ones.
        limits: Tolerances.
        scale: Factor on the claimed translations.
    """
    claimed = np.array(motions, dtype=np.float64)
    claimed[:, :3, 3] *= scale
    offset = claimed[:, :3, 3] - pairs.measured[:, :3, 3]
    error = compose(inverse(pairs.measured), claimed)
    error[:, :3, :3] = np.where(np.isfinite(error[:, :3, :3]), error[:, :3, :3], np.eye(3))
    vector = _rotation_vectors(error[:, :3, :3])
    size_m = np.linalg.norm(pairs.measured[:, :3, 3], axis=1)
    step_m = np.maximum(limits.tolerance_m / pairs.unit_m, limits.tolerance_share * size_m)
    step_m = np.hypot(step_m, limits.sigmas * pairs.sigma_m)
    yaw = np.abs(np.arctan2(pairs.measured[:, 1, 0], pairs.measured[:, 0, 0]))
    yaw_rad = limits.tolerance_rad + limits.tolerance_share * yaw
    yaw_rad = np.hypot(yaw_rad, limits.sigmas * pairs.sigma_rad)
    tilt_rad = _TILT_RAD + _TILT_RATE_RADPS * pairs.dt_s
    parts = (
        np.hypot(offset[:, 0], offset[:, 1]) / step_m,
        np.abs(offset[:, 2]) / (_HEIGHT_TOLERANCE * step_m),
        np.abs(vector[:, 2]) / yaw_rad,
        np.hypot(vector[:, 0], vector[:, 1]) / tilt_rad,
    )
    worst = np.max(parts, axis=0)
    return PoseFit(np.where(np.isfinite(worst), worst, np.inf), offset, vector[:, 2], scale)


def _rotation_vectors(rotation: Floats) -> Floats:
    """Return (p, 3) rotation vectors; of a mirror those of half a turn about each axis."""
    proper = np.linalg.det(rotation) > 0
    vectors = np.full((len(rotation), 3), np.pi)
    if proper.any():
        vectors[proper] = Rotation.from_matrix(rotation[proper]).as_rotvec()
    return vectors


def scale_between(motions: Array, pairs: PosePairs) -> float:
    """Return the factor on claimed translations that brings their lengths to the measured ones; 1 where none moves."""
    claimed = np.linalg.norm(motions[:, :3, 3], axis=1)
    measured = np.linalg.norm(pairs.measured[:, :3, 3], axis=1)
    moving = (claimed > 0) & np.isfinite(claimed) & (measured > 5 * pairs.sigma_m)
    return float(np.exp(np.median(np.log(measured[moving] / claimed[moving])))) if moving.any() else 1.0


def best_explanations(
    candidates: Sequence[PoseHypothesis], pairs: PosePairs, limits: MotionLimitsConfig, *, free_scale: bool
) -> list[tuple[PoseHypothesis, PoseFit]]:
    """Return the hypotheses that explain the sweeps, those that explain them equally well by rank; none may.

    Args:
        candidates: What could be wrong.
        pairs: What was measured.
        limits: Tolerances.
        free_scale: Whether translations may be off by a factor as well.
    """
    fits = []
    for candidate in candidates:
        scale = scale_between(candidate.motions, pairs) if free_scale else 1.0
        fits.append((candidate, fit_motions(candidate.motions, pairs, limits, scale=scale)))
    lowest = min(fit.cost for _, fit in fits)
    equal = [
        (candidate, fit)
        for candidate, fit in fits
        if fit.share >= limits.min_agreeing_share and fit.cost <= 2 * lowest + 0.05
    ]
    return sorted(_finest(equal, pairs, limits), key=lambda item: (item[0].rank, item[1].cost))


def _finest(
    found: list[tuple[PoseHypothesis, PoseFit]], pairs: PosePairs, limits: MotionLimitsConfig
) -> list[tuple[PoseHypothesis, PoseFit]]:
    """Return those whose errors, however small, are not clearly larger than those of the best: an F-test."""
    if not found:
        return found
    ratio = 1 + limits.sigmas * np.sqrt(2 / max(len(pairs), 1))
    for squares in (_yaw_squares, _offset_squares):
        sizes = [squares(fit, pairs) for _, fit in found]
        lowest = min(sizes)
        found = [item for item, size in zip(found, sizes, strict=True) if size <= ratio * lowest]
    return found


def _yaw_squares(fit: PoseFit, pairs: PosePairs) -> float:
    """Return the mean squared error of yaw, at least what the sweeps leave open; outliers do not count."""
    error = np.nan_to_num(np.abs(fit.yaw_rad), nan=np.pi)
    return float(
        np.sort(error**2)[: max(int(0.9 * len(error)), 1)].mean() + (2 * np.median(pairs.sigma_rad)) ** 2
    )


def _offset_squares(fit: PoseFit, pairs: PosePairs) -> float:
    """Return the same of the translation in the plane."""
    error = np.nan_to_num((fit.offset_m[:, :2] ** 2).sum(axis=1), nan=1e6)
    return float(np.sort(error)[: max(int(0.9 * len(error)), 1)].mean() + (2 * np.median(pairs.sigma_m)) ** 2)
