"""Parts that are fetched ahead: each once, and never waited for where they only wait for their turn."""

from __future__ import annotations

import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from upvl_cli.pipeline.storage import read_ahead
from upvl_cli.pipeline.storage.read_ahead import ReadAhead

PATIENCE_S = 20


class Fetches:
    """Fetches of parts that wait until they may go on, and how often each part was fetched."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.may_go_on = threading.Event()
        self._lock = threading.Lock()
        self._begun = threading.Semaphore(0)

    def slow(self, name: str) -> Path:
        path = self.fast(name)
        self._begun.release()
        assert self.may_go_on.wait(PATIENCE_S)
        return path

    def fast(self, name: str) -> Path:
        with self._lock:
            self.counts[name] += 1
        return Path(name)

    def wait_for(self, begun: int) -> None:
        for _ in range(begun):
            assert self._begun.acquire(timeout=PATIENCE_S)


def test_a_part_that_waits_for_its_turn_is_fetched_at_once() -> None:
    ahead, fetches = ReadAhead(), Fetches()
    for number in range(read_ahead._WORKERS):
        ahead.begin(("series", f"busy {number}"), lambda number=number: fetches.slow(f"busy {number}"))
    fetches.wait_for(read_ahead._WORKERS)
    ahead.begin(("series", "waiting"), lambda: fetches.fast("never from here"))
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(ahead.get, ("series", "waiting"), lambda: fetches.fast("waiting"))
        assert asked.result(PATIENCE_S) == Path("waiting")
        fetches.may_go_on.set()
    assert ahead.get(("series", "waiting"), lambda: fetches.fast("again")) == Path("again")
    assert fetches.counts["waiting"] == 1
    assert not fetches.counts["never from here"]


@pytest.mark.parametrize("begun_ahead", [False, True])
def test_a_part_that_is_being_fetched_is_waited_for(begun_ahead: bool) -> None:
    ahead, fetches = ReadAhead(), Fetches()
    with ThreadPoolExecutor(8) as pool:
        if begun_ahead:
            ahead.begin(("series", "part"), lambda: fetches.slow("part"))
        else:
            pool.submit(ahead.get, ("series", "part"), lambda: fetches.slow("part"))
        fetches.wait_for(1)
        asked = [pool.submit(ahead.get, ("series", "part"), lambda: fetches.fast("part")) for _ in range(6)]
        waiting = ahead._in_flight[("series", "part")]._condition._waiters  # type: ignore[attr-defined]
        until_s = time.monotonic() + PATIENCE_S
        while len(waiting) < len(asked) and time.monotonic() < until_s:
            time.sleep(0.001)
        fetches.may_go_on.set()
        assert {one.result(PATIENCE_S) for one in asked} == {Path("part")}
    assert fetches.counts["part"] == 1


def test_what_failed_ahead_is_met_again_where_it_is_asked_for() -> None:
    ahead, begun = ReadAhead(), threading.Event()

    def fails() -> Path:
        begun.set()
        raise OSError("the store is away")

    ahead.begin(("series", "part"), fails)
    assert begun.wait(PATIENCE_S)
    with pytest.raises(OSError, match="away"):
        ahead.get(("series", "part"), fails)
    assert ahead.get(("series", "part"), lambda: Path("part")) == Path("part")
