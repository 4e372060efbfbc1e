"""What a virtual machine's host took away while something was timed: timings of two days differ by that."""

from __future__ import annotations

import os
from pathlib import Path

_STAT = Path("/proc/stat")
_STOLEN = 7  # of the numbers of a line: user, nice, system, idle, iowait, irq, softirq, steal (proc(5))


class Stolen:
    """Counts from when it is made; prints as "the host took 12% of the time asked of 2 cores"."""

    def __init__(self) -> None:
        """Begin to count."""
        self._before = _times()

    def __str__(self) -> str:
        now = _times()
        if not now or not self._before:
            return "what the host took away is not told here"
        passed = [after - before for after, before in zip(now, self._before, strict=True)]
        wanted = sum(passed) - passed[3] - passed[4]  # less what was idle
        return f"the host took {passed[_STOLEN] / max(wanted, 1):.0%} of the time asked of {os.cpu_count()} cores"


def _times() -> list[int]:
    if not _STAT.is_file():
        return []
    return [int(number) for number in _STAT.read_text().split("\n", 1)[0].split()[1:9]]
