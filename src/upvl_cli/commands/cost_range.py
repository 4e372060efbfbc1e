"""A quantity that is estimated from a sample, with the range in which the true one is expected."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

# Of true values, that share is expected inside of the range, half of the others below it.
EXPECTED_INSIDE = 0.8


@dataclass(frozen=True)
class CostRange:
    """An estimate and its range; the unit is that of the field which holds it."""

    low: float
    mean: float
    high: float

    @classmethod
    def about(cls, mean: float, error: float) -> CostRange:
        """Return the range of an estimate whose logarithm is uncertain by `error` either way."""
        return cls(mean * math.exp(-error), mean, mean * math.exp(error))

    @classmethod
    def sum(cls, ranges: Iterable[CostRange]) -> CostRange:
        """Return the sum of quantities that may all be low or all be high."""
        total = cls(0.0, 0.0, 0.0)
        for item in ranges:
            total += item
        return total

    def __add__(self, other: CostRange) -> CostRange:
        return CostRange(self.low + other.low, self.mean + other.mean, self.high + other.high)

    def __mul__(self, factor: float) -> CostRange:
        return CostRange(self.low * factor, self.mean * factor, self.high * factor)

    def at(self, end: Literal["low", "mean", "high"]) -> float:
        """Return an end of the range, or the estimate."""
        return {"low": self.low, "mean": self.mean, "high": self.high}[end]


def from_sample(
    values: Sequence[float],
    frames: Sequence[int],
    total_frames: float,
    *,
    drives: int,
    length_error: float,
    smallest: float,
) -> CostRange:
    """Scale what sampled drives took to all drives, by frames.

    The range is Student's interval of the mean of the logarithms of what a frame takes, for a new mean of `drives`
    drives: costs vary by factors and cannot be negative. With two drives it is wide unless both took nearly the same.

    Args:
        values: What each sampled drive took.
        frames: Number of frames of each of them, at least 1.
        total_frames: Number of frames of all drives.
        drives: Number of all drives.
        length_error: Standard error of `total_frames`, as a share of it.
        smallest: The range is at least that wide either way, in natural logarithms.
    """
    from scipy.special import stdtrit

    mean = sum(values) / sum(frames) * total_frames
    rates = [math.log(value / count) for value, count in zip(values, frames, strict=True) if value > 0]
    if len(rates) < 2:
        return CostRange.about(mean, smallest)
    quantile = float(stdtrit(len(rates) - 1, (1 + EXPECTED_INSIDE) / 2))
    of_rates = quantile * statistics.stdev(rates) * math.sqrt(1 / len(rates) + 1 / drives)
    normal = statistics.NormalDist().inv_cdf((1 + EXPECTED_INSIDE) / 2)
    return CostRange.about(mean, max(smallest, math.hypot(of_rates, normal * length_error)))
