"""Rotated IoU: how exact, how many overlapping pairs a second, how many far pairs rejected a second.

Prints the three figures beside their bars and exits 1 when one is missed. Each speed is the best of some
runs on one core, and stands beside the speed of a plain Python clip measured in the same run: the ratio
means the same on a busy machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from upvl_cli.geometry.iou import iou_3d, iou_3d_pairs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "geometry"))
from exact_clip import shared_area  # noqa: E402

PAIRS = 100_000
RUNS = 7


def random_boxes(rng: np.random.Generator, spread_m: float, count: int) -> NDArray[np.float64]:
    """Return boxes from walkers to trucks around one place."""
    centre, size = rng.normal(0, spread_m, (count, 3)), rng.uniform(0.5, 8, (count, 3))
    return np.column_stack([centre, size, rng.uniform(-np.pi, np.pi, count)])


def best_seconds(work: Callable[[], object], runs: int) -> float:
    """Return the shortest of some runs."""
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def plain_iou(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the 3D IoU of pairs by a polygon clip, one pair at a time."""
    area = np.array([shared_area(p, q, float) for p, q in zip(a.tolist(), b.tolist(), strict=True)])
    tops = np.minimum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    shared = area * np.maximum(tops - np.maximum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2), 0)
    return np.asarray(shared / (a[:, 3:6].prod(axis=1) + b[:, 3:6].prod(axis=1) - shared))


def report(name: str, figure: str, bar: str, passed: bool) -> bool:
    """Print one line and return whether the bar is met."""
    print(f"{name:<28} {figure:<30} bar {bar:<15} {'ok' if passed else 'MISSED'}")
    return passed


def main() -> int:
    """Measure and return the exit code."""
    rng = np.random.default_rng(1)
    a, b = random_boxes(rng, 1.0, PAIRS), random_boxes(rng, 1.0, PAIRS)
    start = time.perf_counter()
    expected = plain_iou(a, b)
    plain_per_s = PAIRS / (time.perf_counter() - start)
    error = float(np.abs(iou_3d_pairs(a, b) - expected).max())

    overlap = expected > 0
    a, b = np.tile(a[overlap], (4, 1)), np.tile(b[overlap], (4, 1))
    pairs_per_s = len(a) / best_seconds(lambda: iou_3d_pairs(a, b), RUNS)

    here = random_boxes(rng, 1000.0, 3000)
    there = here + [1e5, 0, 0, 0, 0, 0, 0]
    far_per_s = len(here) ** 2 / best_seconds(lambda: iou_3d(here, there), RUNS)

    def speed(per_s: float) -> str:
        return f"{per_s:,.0f}/s, {per_s / plain_per_s:,.0f} x plain"

    passed = [
        report("worst error of random pairs", f"{error:.1e} of {PAIRS:,}", "<= 1e-6", error <= 1e-6),
        report("overlapping pairs", speed(pairs_per_s), ">= 500,000/s", pairs_per_s >= 500_000),
        report("far pairs rejected", speed(far_per_s), ">= 10,000,000/s", far_per_s >= 10_000_000),
    ]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    raise SystemExit(main())
