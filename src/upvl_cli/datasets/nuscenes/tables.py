"""The JSON tables: rows found by a key, without holding a table of gigabytes.

`sample_data.json` of the whole of nuScenes has 2.6 million rows. It is read once, row by row; what stays in memory is
where each row lies in the file, 16 bytes a row. The rows of a scene are then read again from there.
"""

from __future__ import annotations

import codecs
import json
import re
import threading
from array import array
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.datasets.shared.content import read_json, unreadable
from upvl_cli.errors import BadInput, one_line
from upvl_cli.types import Array

Row = dict[str, Any]
_CHUNK_BYTES = 4 * 2**20
_MAX_ROW_BYTES = 2**20
_BETWEEN = re.compile(r"[ \t\r\n]*,?[ \t\r\n]*")
_SHOWN = 80
_MAX_NUMBER = 4e15  # microseconds until 2096


def read_table(path: Path) -> list[Row]:
    """Return all rows of a small table.

    Raises:
        BadInput: It cannot be read, or is no list of rows.
    """
    rows = read_json(path)
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(f"{path} is no list of rows; copy it again")
    return rows


class KeyedTable:
    """A large table whose rows are found by one key; the file is not opened before the first search."""

    def __init__(self, path: Path, key: str) -> None:
        self.path = path
        self._key = key
        self._index: tuple[Array, Array] | None = None
        self._lock = threading.Lock()

    def rows(self, keys: Collection[str]) -> list[Row]:
        """Return the rows whose key is one of these, in the order of the file.

        Raises:
            BadInput: The file cannot be read, or is no list of rows that have the key.
        """
        with self._lock:
            if self._index is None:
                self._index = self._read_index()
        hashes, starts = self._index
        wanted = np.unique(np.array([_hash(key) for key in keys], dtype=np.int64))
        first, last = (np.searchsorted(hashes, wanted, side) for side in ("left", "right"))
        ranges = [np.arange(start, end) for start, end in zip(first, last, strict=True)]
        found = np.concatenate([*ranges, np.zeros(0, dtype=np.int64)])
        return [row for row in self._rows_at(np.sort(starts[found]).tolist()) if row[self._key] in keys]

    def _read_index(self) -> tuple[Array, Array]:
        """Return the hash of each row's key, ascending, and where the row starts."""
        hashes, starts = array("q"), array("q")
        for start, row in _scan(self.path):
            key = row.get(self._key)
            if not isinstance(key, str):
                raise BadInput(f"{self.path}: row {len(hashes)} has no text {self._key}; copy it again")
            hashes.append(hash(key))
            starts.append(start)
        hashed = np.frombuffer(hashes, dtype=np.int64) if hashes else np.zeros(0, np.int64)
        order = np.argsort(hashed, kind="stable")
        return hashed[order], np.frombuffer(starts, dtype=np.int64)[order] if starts else hashed

    def _rows_at(self, starts: list[int]) -> Iterator[Row]:
        decode = json.JSONDecoder().raw_decode
        try:
            with self.path.open("rb") as file:
                for start in starts:
                    file.seek(start)
                    # A row has a few hundred bytes; one that is longer is read whole.
                    for size in (2000, _MAX_ROW_BYTES):
                        try:
                            text = (file.read(size)).decode(errors="replace")
                            row = decode(text)[0]
                            break
                        except (ValueError, RecursionError):
                            file.seek(start)
                    else:
                        row = None
                    if not isinstance(row, dict) or not isinstance(row.get(self._key), str):
                        raise BadInput(f"{self.path} changed while it was read; run again")
                    yield row
        except OSError as error:
            raise unreadable(self.path, error) from None


def _hash(key: str) -> int:
    """Return the hash of a key as the scan of the file sees it."""
    return hash(key.encode(errors="replace").decode("latin-1"))


def _scan(path: Path) -> Iterator[tuple[int, Row]]:
    """Yield each row of a table with the byte at which it starts.

    The bytes are read as Latin-1, so that a character is a byte: JSON's own signs are the same in UTF-8.
    """
    decode = json.JSONDecoder().raw_decode
    try:
        with path.open("rb") as file:
            base = len(codecs.BOM_UTF8) if file.read(3) == codecs.BOM_UTF8 else 0
            file.seek(base)
            text = file.read(_CHUNK_BYTES).decode("latin-1")
            place = _BETWEEN.match(text).end()  # type: ignore[union-attr]  # it matches anything
            if text[place : place + 1] != "[":
                raise BadInput(f"{path} is no list of rows; copy it again")
            place += 1
            while True:
                place = _BETWEEN.match(text, place).end()  # type: ignore[union-attr]
                if text[place : place + 1] == "]":
                    return
                row, problem = None, "a row is no object"
                try:
                    row, end = decode(text, place)
                except (ValueError, RecursionError) as error:
                    problem = one_line(error)
                if isinstance(row, dict):
                    yield base + place, row
                    place = end
                    continue
                more = file.read(_CHUNK_BYTES).decode("latin-1") if len(text) - place < _MAX_ROW_BYTES else ""
                if row is not None or not more:
                    raise BadInput(f"{path} is no whole list of rows ({problem[:100]}); copy it again")
                base, text, place = base + place, text[place:] + more, 0
    except OSError as error:
        raise unreadable(path, error) from None


def text_of(row: Row, name: str, path: Path) -> str:
    """Return a text of a row; raises `BadInput` where it has none of that name."""
    value = row.get(name)
    if not isinstance(value, str):
        raise BadInput(f"{path}: {name} of row {row_name(row)} is {shown(value)}, expected text")
    return value


def number_of(row: Row, name: str, path: Path, *, most: float = _MAX_NUMBER) -> float:
    """Return a number of a row, at most `most` on either side; raises `BadInput` where it has none of that name."""
    value = row.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= most:
        raise BadInput(f"{path}: {name} of row {row_name(row)} is {shown(value)}, expected a number")
    return value


def numbers_of(row: Row, name: str, count: int, path: Path) -> Array:
    """Return a list of so many numbers of a row; raises `BadInput` where it has none of that name."""
    value = row.get(name)
    if not isinstance(value, list) or len(value) != count or not all(_is_number(item) for item in value):
        raise BadInput(
            f"{path}: {name} of row {row_name(row)} is {shown(value)}, expected a list of {count} numbers"
        )
    return np.array(value, dtype=np.float64)


def row_name(row: Row) -> str:
    """Return what a row is called in a message: its token."""
    return shown(row.get("token"))


def shown(value: object) -> str:
    """Return a value of a table as a message can hold it: in one line, and not all of it."""
    return repr(value)[:_SHOWN]


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _MAX_NUMBER
