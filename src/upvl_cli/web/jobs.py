"""Work that a page waits for: in few threads, equal work once, and no more of it than can be done soon."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, cast

from upvl_cli.errors import UpvlError

Result = TypeVar("Result")
_MOST_WAITING = 256  # questions; a browser asks one at a time


class TooBusy(UpvlError):
    """More work waits than can be done soon."""


class Jobs:
    """Runs functions in threads for the event loop."""

    def __init__(self, threads: int) -> None:
        """Start without work.

        Args:
            threads: How many functions run at once.
        """
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="upvl-serve")
        self._running: dict[Hashable, asyncio.Future[Any]] = {}

    async def run(self, key: Hashable, function: Callable[[], Result]) -> Result:
        """Return the result of a function; those who wait for the same key share one run.

        Args:
            key: Says what is computed.
            function: Computes it, in a thread.

        Raises:
            TooBusy: Too much waits already.
        """
        future = self._running.get(key)
        if future is None:
            if len(self._running) >= _MOST_WAITING:
                raise TooBusy("too many questions at once; ask again in a few seconds")
            future = asyncio.get_running_loop().run_in_executor(self._pool, function)
            self._running[key] = future
            future.add_done_callback(lambda done: self._forget(key, done))
        # A reader who leaves must not stop the work that others wait for.
        return cast(Result, await asyncio.shield(future))

    def _forget(self, key: Hashable, done: asyncio.Future[Any]) -> None:
        self._running.pop(key, None)
        if not done.cancelled():
            done.exception()  # whoever waits has it; where all have left nobody needs it

    def close(self) -> None:
        """Leave what waits undone."""
        self._pool.shutdown(wait=False, cancel_futures=True)
