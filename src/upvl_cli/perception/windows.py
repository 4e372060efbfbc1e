"""Overlapping windows of time, of which each learns from its sweeps and serves those in its middle."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from upvl_cli.types import Floats

Item = TypeVar("Item")
Item_contra = TypeVar("Item_contra", contravariant=True)
Fit = TypeVar("Fit")
Fit_co = TypeVar("Fit_co", covariant=True)


class Evidence(Protocol[Item_contra, Fit_co]):
    """What is gathered sweep by sweep, and what is fitted to it."""

    def add(self, sweep: Item_contra, /) -> None:
        """Add a sweep."""

    def fit(self) -> Fit_co:
        """Return what is fitted to all that were added."""


class Window(NamedTuple):
    """A part of a drive.

    Attributes:
        learned: Numbers of the sweeps that lie in the window.
        served: Numbers of the sweeps that are nearest to its middle; of all windows together, each sweep once.
    """

    learned: range
    served: range


def overlapping_windows(time_s: Floats, window_s: float) -> list[Window]:
    """Return the windows of a drive, evenly spread; one where the drive is no longer than a window.

    The next begins half a window later or earlier, so that each sweep, but for those at the ends of the drive, has a
    quarter of a window before and after it.

    Args:
        time_s: (T,) ascending time of each sweep.
        window_s: Length of a window.
    """
    if not len(time_s):
        return []
    spare_s = float(time_s[-1] - time_s[0]) - window_s
    total = 1 + max(0, int(np.ceil(2 * spare_s / window_s)))
    if total == 1:
        return [Window(range(len(time_s)), range(len(time_s)))]
    starts_s = time_s[0] + np.linspace(0, spare_s, total)
    begin = np.searchsorted(time_s, starts_s)
    end = np.searchsorted(time_s, starts_s + window_s, side="right")
    end[-1] = len(time_s)  # whatever rounding says
    middle = np.searchsorted(time_s, (starts_s[1:] + starts_s[:-1] + window_s) / 2)
    served = [0, *middle.tolist(), len(time_s)]
    return [Window(range(int(begin[k]), int(end[k])), range(served[k], served[k + 1])) for k in range(total)]


def fits_by_window(
    time_s: Floats,
    sweeps: Iterable[Item],
    window_s: float,
    empty: Callable[[], Evidence[Item, Fit]],
) -> Iterator[tuple[range, Fit]]:
    """Yield the sweeps of a drive, part after part, with what is fitted to a window of time around the part.

    The evidence of three windows at most is held: they overlap by half or a little more.

    Args:
        time_s: (T,) ascending time of each sweep.
        sweeps: T sweeps; taken only as far ahead as the window of the next part reaches.
        window_s: Length of a window.
        empty: Gives evidence without any sweep.
    """
    windows = overlapping_windows(time_s, window_s)
    evidence: dict[int, Evidence[Item, Fit]] = {}
    coming, taken = iter(sweeps), 0
    for number, window in enumerate(windows):
        evidence.setdefault(number, empty())
        while taken < window.learned.stop:
            sweep = next(coming)
            for later in range(number, len(windows)):
                if windows[later].learned.start > taken:
                    break
                if taken in windows[later].learned:
                    evidence.setdefault(later, empty()).add(sweep)
            taken += 1
        yield window.served, evidence.pop(number).fit()
