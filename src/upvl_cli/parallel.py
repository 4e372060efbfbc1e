"""Frames of one drive on all cores: threads, because the heavy steps of numpy and scipy leave Python's lock."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS_VARIABLE = "UPVL_THREADS"


def threads() -> int:
    """How many threads a stage may use: all cores, or what `UPVL_THREADS` says."""
    asked = int(os.environ.get(THREADS_VARIABLE, "0"))
    # Not every system can say which cores a process may use.
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return asked or allowed or 1


def in_order(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """The function of each item, in the order of the items, with as many at once as there are threads.

    Args:
        function: Must not depend on what was computed before; so the results are the same on any machine.
        items: Taken only a few ahead of the results, so that memory stays bounded.
    """
    workers = threads()
    pending: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            # After a failure or Ctrl-C what waits is not worth computing.
            pool.shutdown(wait=True, cancel_futures=True)
