"""What a piece of work takes of the machine: elapsed time, processor time, a GPU, and memory."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Usage:
    """What was taken.

    Attributes:
        seconds: Elapsed time.
        cpu_s: Processor time, user and system, of all threads and of the child processes that have been waited for.
        gpu_s: Elapsed time, where memory of a GPU was allocated meanwhile through torch; else 0.
        peak_mib: Largest resident memory of the process since it started.
    """

    seconds: float
    cpu_s: float
    gpu_s: float
    peak_mib: float


class UsageMeter:
    """Measures from its creation on."""

    def __init__(self) -> None:
        """Start."""
        self._seconds = time.perf_counter()
        self._cpu_s = _cpu_s()
        self._allocations = _gpu_allocations()

    def read(self) -> Usage:
        """Return what has been taken so far."""
        seconds = time.perf_counter() - self._seconds
        # macOS counts bytes, others kibibytes.
        unit = 2**20 if sys.platform == "darwin" else 2**10
        return Usage(
            seconds=seconds,
            cpu_s=_cpu_s() - self._cpu_s,
            gpu_s=seconds if _gpu_allocations() > self._allocations else 0.0,
            peak_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit,
        )


def _cpu_s() -> float:
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _gpu_allocations() -> int:
    """Return how often memory of any GPU has been allocated; torch is asked only where something has loaded it."""
    torch: Any = sys.modules.get("torch")
    cuda = getattr(torch, "cuda", None)
    if cuda is None or not cuda.is_initialized():
        return 0
    return sum(
        int(cuda.memory_stats(device).get("allocation.all.allocated", 0))
        for device in range(cuda.device_count())
    )
