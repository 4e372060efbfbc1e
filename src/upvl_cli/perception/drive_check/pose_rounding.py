"""Positions of poses that were rounded: their steps are multiples of one length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from upvl_cli.perception.drive_check.finding import Finding, Level
from upvl_cli.perception.drive_check.motion_config import MotionLimitsConfig
from upvl_cli.types import Array, Floats

_SMALLEST_M = 0.05  # of a grid that matters: half a metre a second at 10 Hz
_TOLERANCE_M = 0.005  # a lever arm between the unit and the ego axes moves positions by millimetres
_TOLERANCE_SHARE = 0.005  # of a step: the scale of a map changes with latitude
_MIN_SHARE = 0.95
_MIN_CHANGES = 5  # of the number of cells from step to step: a car at constant speed has none
_CANDIDATES = 8
_STEP_SCATTER = 0.41  # of a grid cell: the difference of two rounded values has 1 / sqrt(6)


def rounding_m(world_from_ego: Array) -> float:
    """Return the grid that positions lie on along an axis of the world, in metres; 0 where they lie on none.

    Args:
        world_from_ego: (T, 4, 4) poses.
    """
    steps_m = np.abs(np.diff(np.asarray(world_from_ego)[:, :2, 3], axis=0))
    return max((_grid_m(along) for along in steps_m.T), default=0.0)


def _grid_m(step_m: Floats) -> float:
    """Return the length that all steps along one axis are multiples of, 0 for none."""
    lengths = np.sort(step_m)
    # The grid is a step of one cell, or the difference of two steps.
    candidates = np.unique(np.round(np.append(lengths, np.diff(lengths)), 2))
    for candidate_m in candidates[candidates >= _SMALLEST_M][:_CANDIDATES].tolist():
        cells = np.round(step_m / candidate_m)
        if not cells.any():
            continue
        grid_m = float((step_m * cells).sum() / (cells**2).sum())
        error_m = np.abs(step_m - cells * grid_m)
        share = (error_m < _TOLERANCE_M + _TOLERANCE_SHARE * step_m).mean()
        changes = int((np.diff(cells) != 0).sum())
        if share >= _MIN_SHARE and changes >= _MIN_CHANGES:
            return grid_m
    return 0.0


def check_rounding(world_from_ego: Array, limits: MotionLimitsConfig, remedy: str) -> Iterator[Finding]:
    """Yield a fault where positions are rounded by so much that all that stands seems to move, else a warning.

    Args:
        world_from_ego: (T, 4, 4) poses.
        limits: What matters.
        remedy: What to do about it.
    """
    grid_m = rounding_m(world_from_ego)
    if not grid_m:
        return
    scatter_m = _STEP_SCATTER * grid_m
    words = f"positions lie on a grid of {grid_m:.2f} m, so that steps are off by {scatter_m:.2f} m"
    cause = "rounded positions: a degree of latitude with 5 decimals is 1.1 m"
    level: Level = "fault" if scatter_m > limits.tolerance_m else "warning"
    yield Finding("poses", level, words, "", f"{len(world_from_ego)} poses", cause, remedy)
