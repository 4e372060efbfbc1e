"""Columns of large values in Parquet files, read by the row: lists of numbers and byte strings."""

from __future__ import annotations

import threading
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.datasets.shared.folders import open_parts
from upvl_cli.datasets.shared.parquet_pages import ColumnChunk
from upvl_cli.errors import BadInput, one_line
from upvl_cli.types import Array, Ints

_RECENT_GROUPS = 3  # two threads read neighbors


class _PagedColumn:
    """A column of a Parquet file by row group; only the footer is read when it is made."""

    def __init__(self, path: Path, name: str, *, repeated: bool) -> None:
        self.path, self.name = path, name
        self._where = f"{path}, column {name}"
        try:
            with pq.ParquetFile(open_parts(path)) as file:
                metadata, schema = file.metadata, file.schema
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise BadInput(
                f"{path} cannot be read as Parquet ({one_line(error)[:120]}); copy it again"
            ) from None
        leaves = [
            leaf
            for leaf in range(len(schema))
            if schema.column(leaf).path == name or schema.column(leaf).path.startswith(f"{name}.")
        ]
        if len(leaves) != 1 or schema.column(leaves[0]).max_repetition_level != repeated:
            expected = "lists of numbers" if repeated else "byte strings"
            raise BadInput(f"{self._where}: it is missing or of another type, expected {expected}")
        groups = [metadata.row_group(group) for group in range(metadata.num_row_groups)]
        self.first_rows = np.concatenate([[0], np.cumsum([group.num_rows for group in groups])]).astype(int)
        column = schema.column(leaves[0])
        self._recent: OrderedDict[int, None] = OrderedDict()
        self._recent_lock = threading.Lock()
        self.chunks = [ColumnChunk(path, group.column(leaves[0]), column, self._where) for group in groups]

    def __len__(self) -> int:
        return int(self.first_rows[-1])

    def chunk_of(self, row: int) -> tuple[int, int]:
        """Return the row group of a row and its number in there."""
        if not 0 <= row < len(self):
            raise BadInput(f"{self._where} has {len(self)} rows, expected a row {row}; copy the file again")
        group = int(np.searchsorted(self.first_rows, row, "right")) - 1
        self._note_use(group)
        return group, row - int(self.first_rows[group])

    def _note_use(self, group: int) -> None:
        """Let go of what is kept of row groups that were not read lately: a drive can have one for each row."""
        with self._recent_lock:
            self._recent[group] = None
            self._recent.move_to_end(group)
            if len(self._recent) > _RECENT_GROUPS:
                self.chunks[self._recent.popitem(last=False)[0]].forget()


class ListColumn(_PagedColumn):
    """A column of lists of numbers."""

    def __init__(self, path: Path, name: str, counts: Ints | None = None) -> None:
        """Open the column; no value is read.

        Args:
            path: The Parquet file.
            name: Name of the column.
            counts: (rows,) numbers in each row, from another column; 0 for null. Without them the whole
                row group is read once to find its rows.
        """
        super().__init__(path, name, repeated=True)
        if counts is not None and len(counts) != len(self):
            raise BadInput(f"{self._where} has {len(self)} rows, expected {len(counts)}; copy the file again")
        self._counts = counts
        self._starts: dict[int, Array] = {}
        self._lock = threading.Lock()

    def row(self, row: int) -> Array | None:
        """Return the numbers of a row, None for a null or an empty list.

        Args:
            row: Number of the row in the file.

        Raises:
            BadInput: The file is damaged, or `counts` are not those of the lists.
        """
        group, inside = self.chunk_of(row)
        with self._lock:
            if group not in self._starts:
                self._starts[group] = self._row_starts(group)
        start, stop = self._starts[group][inside : inside + 2].tolist()
        parts = self.chunks[group].read(start, stop)
        values = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if len(values) == stop - start:
            return values
        if len(values) == 0 and stop - start == 1:
            return None
        raise BadInput(f"{self._where}, row {row}: {stop - start - len(values)} numbers are null")

    def _row_starts(self, group: int) -> Array:
        chunk = self.chunks[group]
        begin, end = self.first_rows[group : group + 2]
        if self._counts is not None:
            entries = np.maximum(self._counts[begin:end], 1)  # a null takes the place of a number
            starts = np.concatenate([[0], np.cumsum(entries)])
        else:
            starts = np.append(chunk.row_starts(), chunk.entries)
        if len(starts) != end - begin + 1 or starts[-1] != chunk.entries:
            raise BadInput(
                f"{self._where}: the lists of row group {group} hold {chunk.entries} numbers, expected "
                f"{starts[-1]} in {end - begin} rows; copy the file again"
            )
        return starts


class BytesColumn(_PagedColumn):
    """A column of byte strings, such as pictures."""

    def __init__(self, path: Path, name: str) -> None:
        """Open the column; no value is read."""
        super().__init__(path, name, repeated=False)

    def row(self, row: int) -> bytes | None:
        """Return the bytes of a row, None for a null; raises `BadInput` where the file is damaged.

        Args:
            row: Number of the row in the file.
        """
        group, inside = self.chunk_of(row)
        parts: list[Any] = self.chunks[group].read(inside, inside + 1)
        found = parts[0]
        if isinstance(found, np.ndarray):
            raise BadInput(f"{self._where}: it holds numbers, expected byte strings")
        return bytes(found[0].as_py()) if len(found) else None
