"""Parts of drives fetched before they are asked for, where they are read in order."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path

from upvl_cli.errors import UpvlError

_WORKERS = 8
_AHEAD = 8  # how many parts are fetched before they are asked for
_LARGEST_STEP = 8  # every eighth frame is still an order
_RECENT = 64
_SERIES = 256

Key = tuple[str, str]  # a series, and the name of a part in it


class ReadAhead:
    """Fetches parts of series (files of a folder, blocks of an object); none is fetched twice at the same time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._in_flight: dict[Key, Future[Path]] = {}
        self._asked: OrderedDict[str, deque[int]] = OrderedDict()
        self._pool = ThreadPoolExecutor(_WORKERS, thread_name_prefix="read-ahead")

    def get(self, key: Key, fetch: Callable[[], Path]) -> Path:
        """Return a part: the one that is being fetched, or by fetching it now."""
        mine: Future[Path] = Future()
        mine.set_running_or_notify_cancel()
        while (other := self._begun(key, mine)) is not mine:
            # One that only waits for its turn is fetched here, now. (To cancel calls `_done`: never under the lock.)
            if not other.cancel():
                # What went wrong there is met here again, and said.
                with contextlib.suppress(UpvlError, OSError, CancelledError):
                    return other.result()
                return fetch()
            self._done(key, other)
        try:
            path = fetch()
            mine.set_result(path)
            return path
        except BaseException as error:
            mine.set_exception(error)
            raise
        finally:
            self._done(key, mine)

    def begin(self, key: Key, fetch: Callable[[], Path]) -> None:
        """Begin to fetch a part in another thread, unless it is being fetched."""
        with self._lock:
            if key in self._in_flight:
                return
            future = self._in_flight[key] = self._pool.submit(fetch)
        future.add_done_callback(lambda done: self._done(key, done))

    def next_of(self, series: str, number: int) -> list[int]:
        """Note that a part was asked for, and return the numbers of those that will be, where there is an order.

        Args:
            series: Name of the series.
            number: Number of the part.
        """
        with self._lock:
            asked = self._asked.setdefault(series, deque(maxlen=_RECENT))
            self._asked.move_to_end(series)
            if len(self._asked) > _SERIES:
                self._asked.popitem(last=False)
            known = set(asked)
            if number not in known:
                asked.append(number)
        for step in range(1, _LARGEST_STEP + 1):
            if number - step in known:
                is_order = number - 2 * step in known
                return [number + step * count for count in range(1, _AHEAD + 1)] if is_order else []
        return []

    def _begun(self, key: Key, mine: Future[Path]) -> Future[Path]:
        """Return what fetches a part: another that has begun, else `mine`."""
        with self._lock:
            return self._in_flight.setdefault(key, mine)

    def _done(self, key: Key, future: Future[Path]) -> None:
        with self._lock:
            if self._in_flight.get(key) is future:
                del self._in_flight[key]


@cache
def read_ahead() -> ReadAhead:
    """Return what reads ahead in this process."""
    return ReadAhead()


# A process that is forked has none of the threads of the one that it came from.
os.register_at_fork(after_in_child=read_ahead.cache_clear)
