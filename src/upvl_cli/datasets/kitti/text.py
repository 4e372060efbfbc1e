"""KITTI's text files: lines, numbers and time stamps; anything else is refused by file and line."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Array

_MOST_HOURS = 24  # one drive lasts minutes, and the files of a set are of one day
_TIME = re.compile(r"(19|20)\d\d-\d\d-\d\d \d\d:\d\d:\d\d(\.\d{1,9})?")


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; raises `BadInput` where it is missing or may not be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(
            f"{path} cannot be read ({error.strerror}); check that it is there and readable"
        ) from None


def read_text(path: Path) -> str:
    """Return the content of a text file; raises `BadInput` where it cannot be read or is not text."""
    try:
        return read_bytes(path).decode("utf-8")
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not text; copy it from the data set again") from None


def numbers(text: str, count: int, where: str) -> Array:
    """Return the numbers of one line.

    Args:
        text: Numbers between blanks.
        count: How many there must be.
        where: File and line, for the message.

    Returns:
        (count,) finite float64; raises `BadInput` for anything else.
    """
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        shown = f"{text.strip()[:80]!r}, {len(text.split())} fields"
        raise BadInput(f"{where} holds {shown}; expected {count} finite numbers: copy the file again")
    return values


def read_times(path: Path) -> dict[int, int]:
    """Return the time of each frame: line k of a `timestamps.txt` belongs to frame number k, counted from 0.

    Returns:
        Frame number to nanoseconds since 1970; a blank line gives its frame no time. Raises `BadInput`
        for any other line that is not `YYYY-MM-DD HH:MM:SS.fffffffff`, and where two are a day apart.
    """
    times = {}
    for frame, line in enumerate(read_text(path).splitlines()):
        if line.strip():
            times[frame] = _nanoseconds(line.strip(), f"{path}, line {frame + 1}")
    _check_span(times, path)
    return times


def _check_span(times: dict[int, int], path: Path) -> None:
    if not times:
        return
    first, last = min(times, key=times.__getitem__), max(times, key=times.__getitem__)
    hours = (times[last] - times[first]) / 3.6e12
    if hours > _MOST_HOURS:
        raise BadInput(
            f"{path}, lines {first + 1} and {last + 1} are {hours:.0f} hours apart, expected less than "
            f"{_MOST_HOURS} in one drive; mend the wrong one"
        )


def _nanoseconds(text: str, where: str) -> int:
    try:
        if _TIME.fullmatch(text) and (time_ns := int(np.datetime64(text, "ns").astype(np.int64))) >= 0:
            return time_ns
    except ValueError:  # a month 13 or the like
        pass
    raise BadInput(
        f"{where} holds {text[:80]!r}; expected a time since 1970 such as 2011-09-26 13:02:25.594360375"
    )
