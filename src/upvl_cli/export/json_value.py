"""JSON that a tool wrote, one value at a time: each says where it stands when it is not what it has to be."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadInput
from upvl_cli.export.text import read_json

_MOST = 1e12  # no place, size or count of a drive is larger; a damaged number is
_MOST_WHOLE = 2**53  # up to here JSON numbers of every program are exact


@dataclass(frozen=True)
class JsonValue:
    """A value of a JSON file.

    Attributes:
        value: What the file holds there.
        where: The file, and the way to the value in it.
    """

    value: Any
    where: str

    @classmethod
    def of_file(cls, path: Path) -> JsonValue:
        """Return the whole content of a file; raises `BadInput` where it is no JSON."""
        return cls(read_json(path), str(path))

    def member(self, name: str) -> JsonValue:
        """Return a member that has to be there."""
        found = self.optional(name)
        if found is None:
            raise BadInput(f"{self.where} has no {name!r}; expected one")
        return found

    def optional(self, name: str) -> JsonValue | None:
        """Return a member; None where it is missing or null."""
        members = self._object()
        return None if members.get(name) is None else JsonValue(members[name], f"{self.where}, {name}")

    def members(self) -> Iterator[tuple[str, JsonValue]]:
        """Yield the members of an object, those that are null left out."""
        for name, value in self._object().items():
            if value is not None:
                yield name, JsonValue(value, f"{self.where}, {name[:60]}")

    def elements(self) -> Iterator[JsonValue]:
        """Yield the elements of a list."""
        if not isinstance(self.value, list):
            raise self._wrong("a list")
        for place, value in enumerate(self.value):
            yield JsonValue(value, f"{self.where}[{place}]")

    def number(self) -> float:
        """Return a finite number; text that spells one counts, because some tools write all values as text."""
        value = self.value
        try:
            number = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError, OverflowError):
            raise self._wrong("a number") from None
        if not abs(number) <= _MOST:
            raise self._wrong(f"a number of at most {_MOST:g}")
        return number

    def integer(self) -> int:
        """Return a whole number."""
        number = self.value if isinstance(self.value, int) else self.number()
        if isinstance(number, bool) or number != int(number) or abs(number) >= _MOST_WHOLE:
            raise self._wrong("a whole number")
        return int(number)

    def text(self) -> str:
        """Return text that is not empty."""
        if not isinstance(self.value, str) or not self.value.strip():
            raise self._wrong("text")
        return self.value

    def identifier(self) -> str:
        """Return what names a thing: text, or a whole number as text."""
        if isinstance(self.value, str):
            return self.text()
        return str(self.integer())

    def numbers(self, *names: str) -> list[float]:
        """Return the numbers of an object's members."""
        return [self.member(name).number() for name in names]

    def list_of_numbers(self, lengths: Sequence[int]) -> list[float]:
        """Return the numbers of a list that has one of these lengths."""
        found = [element.number() for element in self.elements()]
        if len(found) not in lengths:
            raise BadInput(
                f"{self.where} has {len(found)} numbers; expected {' or '.join(map(str, lengths))}"
            )
        return found

    def _object(self) -> dict[str, Any]:
        if not isinstance(self.value, dict):
            raise self._wrong("an object with members")
        return self.value

    def _wrong(self, expected: str) -> BadInput:
        if isinstance(self.value, dict | list):
            found = "an object" if isinstance(self.value, dict) else "a list"
        else:
            found = " ".join(repr(self.value)[:40].split())
        return BadInput(f"{self.where} is {found}; expected {expected}")
