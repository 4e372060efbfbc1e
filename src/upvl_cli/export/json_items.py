"""JSON files written item by item, so that a table of many drives is never held."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any, Self


class JsonItems:
    """The items of one list, or the members of one object."""

    def __init__(self, path: Path, opening: str = "[", closing: str = "]") -> None:
        """Begin a file.

        Args:
            path: The file.
            opening: What stands before the items.
            closing: What stands after them.
        """
        self._file = path.open("w", encoding="utf-8")
        self._before, self._closing = f"{opening}\n", closing
        self._opening = self._before

    def add(self, value: Any, name: str = "") -> None:
        """Write one item; with a name, as a member of the object."""
        member = f"{json.dumps(name)}: " if name else ""
        self._file.write(f"{self._before}{member}{json.dumps(value)}")
        self._before = ",\n"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        start = self._opening if self._before == self._opening else "\n"
        self._file.write(f"{start}{self._closing}\n")
        self._file.close()
