"""Search of the motion between two sweeps without a guess: correlation of their ground plans over shifts and turns."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import fft

from upvl_cli.geometry.se3 import from_yaw
from upvl_cli.perception.odometry.config import SearchConfig
from upvl_cli.types import Array, Bools, Floats


class Reach(NamedTuple):
    """How far a motion may be from the expected one: `shift_m` in the ground plan and `turn_rad` about the vertical."""

    shift_m: float
    turn_rad: float


def search_motion(
    target_xyz_m: Floats, source_xyz_m: Floats, expected: Array, reach: Reach, config: SearchConfig
) -> list[Array]:
    """Return (4, 4) motions target_from_source under which the ground plans agree most, the best one first.

    Occupancy grids are correlated by the Fourier transform for each of some turns: all shifts at once, as in
    Olson, Real-time correlative scan matching, ICRA 2009.

    Args:
        target_xyz_m: (n, 3) upright points of the sweep before.
        source_xyz_m: (m, 3) upright points of the sweep.
        expected: (4, 4) motion that the search is laid around.
        reach: How far around it.
        config: Cells and bounds.
    """
    if not len(target_xyz_m) or not len(source_xyz_m):
        return []
    side = int(np.ceil(2 * config.range_m / config.cell_m))
    size = fft.next_fast_len(side + int(np.ceil(config.max_shift_m / config.cell_m)), real=True)
    plan = _widen(_ground_plan(target_xyz_m[:, :2], side, size, config))
    target = np.conj(fft.rfft2(plan))
    yaw_0 = float(np.arctan2(expected[1, 0], expected[0, 0]))
    steps = int(np.ceil(min(reach.turn_rad, config.max_turn_rad) / config.yaw_step_rad))
    allowed = _allowed_shifts(size, expected[:2, 3], min(reach.shift_m, config.max_shift_m), config)
    rows = []
    for turn in range(-steps, steps + 1):
        yaw = yaw_0 + turn * config.yaw_step_rad
        turned = source_xyz_m @ from_yaw(yaw, np.zeros(3))[:3, :3].T
        grid = _ground_plan(turned[:, :2], side, size, config)
        # Correlation at the shift s: the sum over cells c of source(c) target(c + s).
        score = np.where(allowed, fft.irfft2(np.conj(fft.rfft2(grid) * target), s=(size, size)), -1.0)
        rows += [(value, x, y, yaw) for value, x, y in _peaks(score, config)]
    return [from_yaw(yaw, np.array([x, y, expected[2, 3]])) for x, y, yaw in _distinct(rows, config)]


def _ground_plan(xy_m: Floats, side: int, size: int, config: SearchConfig) -> Floats:
    """(size, size) float32: 1 in the cells of the first (side, side) that hold a point, padded by zeros."""
    cells = np.floor(xy_m / config.cell_m).astype(np.int64) + side // 2
    cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
    plan = np.zeros((size, size), dtype=np.float32)
    plan[cells[:, 0], cells[:, 1]] = 1.0
    return plan


def _widen(plan: Floats) -> Floats:
    """Return the plan with half the weight in the cells beside: a turn between two steps is met as well."""
    beside = np.zeros_like(plan)
    for axis in (0, 1):
        for shift in (-1, 1):
            beside = np.maximum(beside, np.roll(plan, shift, axis=axis))
    return np.asarray(np.maximum(plan, np.float32(0.5) * beside))


def _allowed_shifts(size: int, expected_xy_m: Floats, reach_m: float, config: SearchConfig) -> Bools:
    """(size, size) which shifts lie within reach."""
    shift_m = fft.fftfreq(size, 1 / size) * config.cell_m
    x, y = shift_m[:, None] - expected_xy_m[0], shift_m[None] - expected_xy_m[1]
    allowed: Bools = x**2 + y**2 <= reach_m**2
    return allowed


def _peaks(score: Floats, config: SearchConfig) -> Iterator[tuple[float, float, float]]:
    """Yield score, x and y of the best shifts, each some cells from the better ones."""
    size = len(score)
    score = score.copy()
    apart = int(np.ceil(config.apart_m / config.cell_m))
    around = np.arange(-apart, apart + 1)
    for _ in range(config.candidates):
        row, column = np.unravel_index(int(score.argmax()), score.shape)
        value = float(score[row, column])
        if value <= 0:
            return
        x, y = ((int(cell) + size // 2) % size - size // 2 for cell in (row, column))
        yield value, x * config.cell_m, y * config.cell_m
        score[np.ix_((row + around) % size, (column + around) % size)] = -1.0


def _distinct(
    rows: list[tuple[float, float, float, float]], config: SearchConfig
) -> list[tuple[float, float, float]]:
    """Return x, y and yaw of the best of all turns: of shifts at the same place the better turn."""
    kept: list[tuple[float, float, float]] = []
    for _, x, y, yaw in sorted(rows, key=lambda row: -row[0]):
        if all(np.hypot(x - other[0], y - other[1]) > config.apart_m for other in kept):
            kept.append((x, y, yaw))
        if len(kept) == config.candidates:
            break
    return kept
