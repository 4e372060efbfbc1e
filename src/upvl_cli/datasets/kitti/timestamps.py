"""Times and other lines that belong to frames: which line is whose, and what time it holds."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.datasets.shared.times import MAX_SPAN_H
from upvl_cli.errors import BadInput

# Where nobody wrote the times down. KITTI's LiDAR and that of View-of-Delft turn ten times a second.
NOMINAL_STEP_NS = 100_000_000
TIMES_ASSUMED = "frame times assumed (10 a second)"

_TIME = re.compile(r"(19|20)\d\d-\d\d-\d\d \d\d:\d\d:\d\d(\.\d{1,9})?")
_MAX_SECONDS = 9e9  # nanoseconds of it fit in 64 bits
# Files with gaps in their numbers follow their lines in order where the times show those gaps too: the time of
# one number, from the longest to the shortest.
_SAME_PACE = 1.5


def read_timestamps(path: Path) -> list[int | None]:
    """Return the time of each line of a `timestamps.txt`, in nanoseconds since 1970; None for a blank line.

    Raises:
        BadInput: A line is not `YYYY-MM-DD HH:MM:SS.fffffffff`, or two are a day apart.
    """
    return _read(path, _nanoseconds)


def read_seconds(path: Path) -> list[int | None]:
    """Return the time of each line of a `times.txt`, in nanoseconds; None for a blank line.

    Raises:
        BadInput: A line is no number of seconds, or two are a day apart.
    """
    return _read(path, _seconds)


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file without blank ones at its end."""
    return read_text(path).rstrip().splitlines()


def times_of_frames(line_times: Sequence[int | None], files: Collection[int], path: Path) -> dict[int, int]:
    """Return the time of each frame number.

    Args:
        line_times: The time of each line, None for a blank one.
        files: The frame numbers of the files that the lines belong to.
        path: Where the times are from, for the message.

    Raises:
        BadInput: It cannot be known which line belongs to which file.
    """
    lines = lines_of_frames(len(line_times), files, path, _same_pace(line_times))
    return {frame: time for frame, line in lines.items() if (time := line_times[line]) is not None}


def lines_of_frames(
    lines: int, files: Collection[int], path: Path, same_pace: Callable[[Sequence[int]], bool] | None = None
) -> dict[int, int]:
    """Return which line of a file, counted from 0, belongs to each frame number.

    Line k is of frame number k wherever there are lines for all numbers. A recording that starts at another
    number and has exactly as many lines as files has one a file, in their order.

    Args:
        lines: How many lines there are.
        files: The frame numbers of the files that they belong to.
        path: Where the lines are from, for the message.
        same_pace: Whether the lines go on as these ascending numbers do; without it no gap is allowed.

    Raises:
        BadInput: It cannot be known which line belongs to which file.
    """
    ordered, count = sorted(files), len(files)
    if not ordered or lines > ordered[-1] or lines > count or (lines < count and ordered[0] == 0):
        return {number: number for number in range(lines)}
    has_gap = ordered[-1] - ordered[0] + 1 != count
    if lines == count and (not has_gap or (same_pace is not None and same_pace(ordered))):
        return {number: line for line, number in enumerate(ordered)}
    raise BadInput(
        f"{path} has {lines} lines for {count} files numbered {ordered[0]} to {ordered[-1]}, and which belongs to "
        f"which is unknown; expected a line for each number from 0 to {ordered[-1]}, or one for each file without "
        "a gap in their numbers: copy it again"
    )


def _same_pace(line_times: Sequence[int | None]) -> Callable[[Sequence[int]], bool]:
    """Return whether the times go on as ascending frame numbers do."""

    def check(ordered: Sequence[int]) -> bool:
        times = [time for time in line_times if time is not None]
        if len(times) != len(ordered):
            return False
        pace = np.diff(np.array(times, dtype=float)) / np.diff(np.array(ordered, dtype=float))
        return bool(0 < pace.max(initial=0) <= _SAME_PACE * pace.min(initial=np.inf))

    return check


def _read(path: Path, parse: Callable[[str, str], int]) -> list[int | None]:
    line_times = [
        parse(line.strip(), f"{path}, line {number}") if line.strip() else None
        for number, line in enumerate(read_lines(path), start=1)
    ]
    known = {line: time for line, time in enumerate(line_times, start=1) if time is not None}
    if known:
        first, last = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
        hours = (known[last] - known[first]) / 3.6e12
        if hours > MAX_SPAN_H:
            raise BadInput(
                f"{path}, lines {first} and {last} are {hours:.0f} hours apart, expected less than "
                f"{MAX_SPAN_H:g} in one drive; mend the wrong one"
            )
    return line_times


def _nanoseconds(text: str, where: str) -> int:
    try:
        if _TIME.fullmatch(text) and (time_ns := int(np.datetime64(text, "ns").astype(np.int64))) >= 0:
            return time_ns
    except ValueError:  # a month 13 or the like
        pass
    raise BadInput(
        f"{where} holds {text[:80]!r}; expected a time since 1970 such as 2011-09-26 13:02:25.594360375"
    )


def _seconds(text: str, where: str) -> int:
    seconds = float(numbers(text, 1, where)[0])
    if not 0 <= seconds < _MAX_SECONDS:
        raise BadInput(f"{where} holds {text[:80]!r}; expected seconds such as 1.036224e-01")
    return round(seconds * 1e9)
