"""On which scale a LiDAR gives the strength of its returns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from upvl_cli.types import Array

Scale = Literal["none", "constant", "0 to 1", "0 to 255", "0 to 65535", "unknown"]

_FULL: tuple[tuple[Scale, float], ...] = (("0 to 1", 1.0), ("0 to 255", 255.0), ("0 to 65535", 65535.0))
_LEVELS = ((8, 255), (16, 65535))  # bits and steps of the scale
_ROUNDED = 1e-3  # of a step


@dataclass(frozen=True)
class IntensityScale:
    """What the intensities of a LiDAR are.

    Attributes:
        scale: Their scale; "none" where all are 0, "unknown" where some are negative, not finite or too large.
        lowest: The lowest one.
        highest: The highest one.
        bits: 8 or 16 where they are whole steps of such a scale, else 0.
    """

    scale: Scale
    lowest: float
    highest: float
    bits: int = 0

    @property
    def full(self) -> float:
        """The intensity that counts as 1; 0 where that is unknown."""
        return dict(_FULL).get(self.scale, 0.0)


def measure_intensity(sweeps: Iterable[Array]) -> IntensityScale:
    """Return the scale of the intensities of some sweeps, each (n,)."""
    parts = [np.asarray(values, dtype=np.float64) for values in sweeps]
    values = np.concatenate(parts) if parts else np.zeros(0)
    if not len(values):
        return IntensityScale("none", 0.0, 0.0)
    lowest, highest = float(values.min()), float(values.max())
    if not np.isfinite(values).all() or lowest < 0:
        return IntensityScale("unknown", lowest, highest)
    if lowest == highest:
        return IntensityScale("none" if highest == 0 else "constant", lowest, highest)
    scale, full = next(((name, full) for name, full in _FULL if highest <= full), ("unknown", highest))
    return IntensityScale(scale, lowest, highest, _bits(values / full))


def _bits(values: Array) -> int:
    """Return the bits of values from 0 to 1 that are whole steps, 0 where they are none."""
    some = values[:: max(1, len(values) // 20_000)]
    for bits, steps in _LEVELS:
        if np.abs(some * steps - np.rint(some * steps)).max() < _ROUNDED * max(1.0, steps / 255):
            return bits
    return 0
