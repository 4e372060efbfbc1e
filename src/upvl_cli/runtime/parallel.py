"""Frames of one drive on all cores: threads, because the heavy steps of numpy and scipy leave Python's lock."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from upvl_cli.errors import BadSetting

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS_VARIABLE = "UPVL_THREADS"


def threads() -> int:
    """Return how many threads a stage may use: as many as there are cores, or the number in `UPVL_THREADS`.

    Raises:
        BadSetting: The variable is not a whole number from 1 on.
    """
    text = os.environ.get(THREADS_VARIABLE)
    if text is not None and not (text.isascii() and text.isdigit() and len(text) < 5 and int(text) > 0):
        raise BadSetting(
            f"{THREADS_VARIABLE} is {text!r}, expected a whole number from 1 to 9999, or nothing"
        )
    # Not every system can say which cores a process may use.
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return int(text) if text else allowed or 1


def in_order(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the function of each item, in the order of the items, computed by as many threads as there are cores.

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


def prepare_worker(parent: int) -> None:
    """Make a worker process leave Ctrl-C to its parent, clean up when told to end, and end with its parent.

    Args:
        parent: Number of the parent process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent has: a killed parent cannot tell its children."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
