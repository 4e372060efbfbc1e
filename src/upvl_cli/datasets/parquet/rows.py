"""Single rows of a large Parquet file, in any order, in bounded memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from upvl_cli.datasets.shared.arrow import arrow_errors, open_parquet
from upvl_cli.errors import BadInput

_WINDOW = 8  # rows kept of a row group with many: neighbors in time are asked for by turns
_BUFFER_BYTES = 2**20  # read at once of a column


class ParquetRows:
    """Rows of some columns of a file; best with a row group a row.

    Rows of a row group with many are read as a stream, of which the last few are kept: forwards costs nothing more,
    but a step far back starts again at the head of the group.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        """Open the file.

        Args:
            path: The file.
            columns: Names of columns that it has.

        Raises:
            BadInput: It is no Parquet file.
        """
        self._path, self._columns = path, list(columns)
        self._file = open_parquet(path)
        metadata = self._file.metadata
        counts = [metadata.row_group(group).num_rows for group in range(metadata.num_row_groups)]
        self._first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, pa.Table] = OrderedDict()
        self._stream: Iterator[pa.RecordBatch] = iter(())
        self._group, self._next = -1, 0  # the row group of the stream, and the row that it gives next

    def __len__(self) -> int:
        return int(self._first[-1])

    def read(self, row: int) -> pa.Table:
        """Return a table with one row.

        Raises:
            BadInput: The file is damaged there.
        """
        group = int(np.searchsorted(self._first, row, side="right")) - 1
        with self._lock, arrow_errors(f"{self._path}, row {row}"):
            if self._first[group + 1] - self._first[group] == 1:
                return self._file.read_row_group(group, columns=self._columns, use_threads=False)
            if row not in self._kept:
                self._advance(group, row)
            return self._kept[row]

    def _advance(self, group: int, row: int) -> None:
        """Read the stream up to a row."""
        if group != self._group or self._next > row:
            # Small buffers instead of the whole row group, which can be the whole drive.
            self._file = open_parquet(self._path, buffer_bytes=_BUFFER_BYTES)
            self._stream = self._file.iter_batches(
                batch_size=1, row_groups=[group], columns=self._columns, use_threads=False
            )
            self._group, self._next = group, int(self._first[group])
            self._kept.clear()
        while self._next <= row:
            batch = next(self._stream, None)
            if batch is None or batch.num_rows != 1:
                raise BadInput(f"{self._path} ends before row {row}; write or copy it again")
            self._kept[self._next] = pa.Table.from_batches([batch])
            self._next += 1
            if len(self._kept) > _WINDOW:
                self._kept.popitem(last=False)
