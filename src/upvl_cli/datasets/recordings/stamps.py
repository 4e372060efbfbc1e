"""Times as people write them: Unix times in four units, dates, in files of one stamp a line and in file names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.content import read_text
from upvl_cli.errors import BadInput

_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_./]?([01]\d)[-_./]?([0-3]\d)[T _-]?([0-2]\d)[-_:]?([0-5]\d)[-_:]?([0-6]\d)"
    r"(?:[.,_-]?(\d{1,9}))?(?!\d)"
)
_SECONDS = re.compile(r"(?<!\d)([1-3]\d{9})([._])(\d{1,9})(?!\d)")
_WHOLE_NUMBER = re.compile(r"(?<!\d)(\d{10}|\d{13}|\d{16}|\d{19})(?!\d)")
_FIRST_S, _LAST_S = 10**9, 4 * 10**9  # 2001 to 2096: a frame number of ten digits is less
_UNITS = (10**9, 10**6, 10**3, 1)  # nanoseconds of a second, a millisecond, a microsecond, a nanosecond
_MOST_NS = 2**62
_STEP_S = (0.005, 5.0)  # between two sweeps or poses: two units cannot both be right


def times_in_names(stems: Sequence[str]) -> list[int] | None:
    """Return the time in each file name in nanoseconds; None where not every name has one.

    Args:
        stems: Names without suffix: `1532402927.647951`, `1532402927647951`, `1532402927_647951000`,
            `lidar-2018-07-24-11-28-47.647951`; more may stand before and behind.
    """
    for search in (_unix_time, _date_time):
        times = [search(stem) for stem in stems]
        found = [time_ns for time_ns in times if time_ns is not None]
        if len(found) == len(stems) and len(set(found)) == len(stems):
            return found
    return None


def _unix_time(text: str) -> int | None:
    found = _SECONDS.search(text)
    if found and int(found[1]) < _LAST_S:
        # Behind a point stands a fraction, behind an underscore a number of nanoseconds (sec_nsec of ROS).
        return int(found[1]) * 10**9 + int(found[3].ljust(9, "0") if found[2] == "." else found[3])
    for number in _WHOLE_NUMBER.findall(text):
        unit = _UNITS[(len(number) - 10) // 3]
        if _FIRST_S <= int(number) * unit // 10**9 < _LAST_S:
            return int(number) * unit
    return None


def _date_time(text: str) -> int | None:
    found = _DATE.search(text)
    if found is None:
        return None
    year, month, day, hour, minute, second, fraction = found.groups(default="0")
    try:
        time = np.datetime64(f"{year}-{month}-{day}T{hour}:{minute}:{second}.{fraction.ljust(9, '0')}", "ns")
    except ValueError:
        return None
    return int(time.astype(np.int64))


def parse_stamps(texts: Sequence[str], where: Path) -> list[int]:
    """Return the times of a column of a file in nanoseconds, all in one unit.

    Args:
        texts: Numbers or dates as they stand.
        where: The file, for messages.

    Raises:
        BadInput: One is no time, or no unit fits.
    """
    numbers: list[Decimal] = []
    dates: list[int] = []
    for row, text in enumerate(texts, start=1):
        date_ns = _date_time(text) if _DATE.fullmatch(text.strip()) and not text.strip().isdigit() else None
        number = _number(text)
        if date_ns is not None:
            dates.append(date_ns)
        elif number is not None:
            numbers.append(number)
        if date_ns is None and number is None or (numbers and dates):
            raise BadInput(
                f"{where}: time number {row} is {text[:60]!r}; expected a number such as 1532402927.647951, or a "
                "date such as 2018-07-24 11:28:47.647951, of one kind in all rows"
            )
    if dates:
        return dates
    unit = _unit(numbers)
    times = [int(number * unit) for number in numbers]
    if times and max(map(abs, times)) >= _MOST_NS:
        raise BadInput(
            f"{where}: the time {max(numbers, key=abs):.6g} is out of range; expected seconds since 1970"
        )
    return times


def _number(text: str) -> Decimal | None:
    try:
        number = Decimal(text.strip())
    except InvalidOperation:
        return None
    return number if number.is_finite() and abs(number.adjusted()) < 30 or number == 0 else None


def _unit(numbers: Sequence[Decimal]) -> int:
    """Return the nanoseconds of one unit: by the year where the numbers are Unix times, else by their steps."""
    if not numbers:
        return _UNITS[0]
    for unit in _UNITS:
        if _FIRST_S * 10**9 <= numbers[0] * unit < _LAST_S * 10**9:
            return unit
    if any(number != number.to_integral_value() for number in numbers) or len(numbers) < 2:
        return _UNITS[0]
    steps = sorted(abs(after - before) for before, after in zip(numbers, numbers[1:], strict=False))
    step = float(steps[len(steps) // 2])
    return next((unit for unit in _UNITS if _STEP_S[0] <= step * unit / 1e9 < _STEP_S[1]), _UNITS[0])


def read_time_file(path: Path, stems: Sequence[str]) -> list[int | None]:
    """Return the time of each sweep from a file of one stamp a line.

    A line `name stamp` belongs to the sweep of that name. Else line k belongs to the k-th sweep where there are as many
    lines as sweeps, and to the sweep number k, counted from 0, where the sweeps are numbered and there are more lines.

    Args:
        path: The file; a blank line gives its sweep no time.
        stems: Names of the sweeps without suffix.

    Raises:
        BadInput: A line is no time, or lines and sweeps cannot be paired.
    """
    lines = [
        line.strip() for line in read_text(path).splitlines() if not line.lstrip().startswith(("#", "%"))
    ]
    while lines and not lines[-1]:
        lines.pop()
    pairs = [line.replace(",", " ").split() for line in lines if line]
    by_name = {Path(pair[0]).stem: pair[1] for pair in pairs if len(pair) >= 2} | {
        pair[0]: pair[1] for pair in pairs if len(pair) >= 2
    }
    if by_name and all(stem in by_name for stem in stems):
        return list(parse_stamps([by_name[stem] for stem in stems], path))
    filled = [place for place, line in enumerate(lines) if line]
    times = dict(zip(filled, parse_stamps([lines[place] for place in filled], path), strict=True))
    if len(lines) == len(stems):
        return [times.get(place) for place in range(len(stems))]
    numbers = [int(stem) for stem in stems if stem.isascii() and stem.isdigit() and len(stem) < 12]
    if len(numbers) == len(stems) and max(numbers, default=0) < len(lines):
        return [times.get(number) for number in numbers]
    raise BadInput(
        f"{path} has {len(lines)} lines for {len(stems)} sweeps ({stems[0]} to {stems[-1]}); expected one stamp a "
        "sweep, or lines 'name stamp'"
    )
