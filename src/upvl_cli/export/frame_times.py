"""Frames found by the times that formats have of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportDrive
from upvl_cli.types import Ints

_TOLERANCE_NS = 1_000_000  # formats round to microseconds; sweeps are 50 ms apart and more
_MAX_NS = 4 * 10**18  # the year 2096: distances between times then fit 64 bits


def time_us(time_ns: int) -> int:
    """Return a time in whole microseconds, rounded down."""
    return int(time_ns) // 1000


def frames_at_us(drive: ExportDrive, times_us: Sequence[int] | Ints, where: object) -> Ints:
    """Return (n,) the index of the frame at each time in microseconds; see `frames_at_ns`."""
    times = [int(time) * 1000 for time in times_us]
    _check_range(times, where)
    return drive.frames_at(np.array(times, dtype=np.int64), _TOLERANCE_NS)


def frames_at_ns(drive: ExportDrive, times_ns: Sequence[int] | Ints, where: object) -> Ints:
    """Return (n,) the index of the frame at each time.

    Args:
        drive: The drive.
        times_ns: (n,) times.
        where: The file, for messages.

    Raises:
        BadInput: The drive has no frame within a millisecond of one.
    """
    times = [int(time) for time in times_ns]
    _check_range(times, where)
    return drive.frames_at(np.array(times, dtype=np.int64), _TOLERANCE_NS)


def _check_range(times_ns: list[int], where: object) -> None:
    wrong = [time for time in times_ns if abs(time) > _MAX_NS]
    if wrong:
        raise BadInput(
            f"{where} has a box at {wrong[0] / 1e9:.3g} s; expected the time of a frame, before 2096"
        )
