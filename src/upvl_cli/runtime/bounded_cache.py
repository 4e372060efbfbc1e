"""Caches in memory that forget what was used longest ago."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class BoundedCache(Generic[Value]):
    """Keeps values as long as their sizes add up to no more than a limit; safe for threads."""

    def __init__(self, limit: int, size_of: Callable[[Value], int] = lambda _: 1) -> None:
        """Start empty.

        Args:
            limit: Largest sum of sizes.
            size_of: Gives the size of a value; without it each value counts one.
        """
        self._limit, self._size_of = limit, size_of
        self._values: OrderedDict[Hashable, tuple[Value, int]] = OrderedDict()
        self._total = 0
        self._lock = threading.Lock()

    def get(self, key: Hashable) -> Value | None:
        """Return a value, or None where there is none."""
        with self._lock:
            entry = self._values.get(key)
            if entry is None:
                return None
            self._values.move_to_end(key)
            return entry[0]

    def put(self, key: Hashable, value: Value) -> None:
        """Keep a value, unless it alone is larger than the limit."""
        size = self._size_of(value)
        with self._lock:
            _, previous = self._values.pop(key, (value, 0))
            self._total -= previous
            if size > self._limit:
                return
            self._values[key] = value, size
            self._total += size
            while self._total > self._limit:
                _, (_, forgotten) = self._values.popitem(last=False)
                self._total -= forgotten

    def get_or_make(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value, made where there is none; two threads may make the same."""
        value = self.get(key)
        if value is None:
            value = make()
            self.put(key, value)
        return value

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._values.clear()
            self._total = 0
