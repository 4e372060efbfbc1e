"""Pages of one column of a Parquet file, each read alone: pyarrow cannot seek inside a row group.

A page is split into its levels, which numpy reads, and its values. Plain numbers are taken as they lie; every
other encoding is decoded by pyarrow, from a Parquet file of that one page that is built in memory.
"""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.folders import read_at
from upvl_cli.datasets.shared.parquet_encoding import LevelRuns, read_levels, single_column_file
from upvl_cli.datasets.shared.thrift import Fields, ShortInput, read_struct, write_struct
from upvl_cli.errors import BadInput, one_line
from upvl_cli.types import Bools, Ints

_HEADER_BYTES = (96, 4096, 1 << 20)  # tried in turn: the statistics in a header can be long
_MOST_PAGE_BYTES = 1 << 28  # writers make pages of about 1 MB
_MOST_PAGE_VALUES = 1 << 26
_MOST_CACHED_BYTES = 1 << 24  # of a decoded page that is kept
_CACHED_PAGES = 2  # a row can end in a page in which the next one begins

_DATA_PAGE, _INDEX_PAGE, _DICTIONARY_PAGE, _DATA_PAGE_V2 = 0, 1, 2, 3
_PLAIN, _PLAIN_DICTIONARY, _RLE, _RLE_DICTIONARY = 0, 2, 3, 8
_TYPES = {"BOOLEAN": 0, "INT32": 1, "INT64": 2, "FLOAT": 4, "DOUBLE": 5, "BYTE_ARRAY": 6}
_PLAIN_TYPES = {"INT32": "<i4", "INT64": "<i8", "FLOAT": "<f4", "DOUBLE": "<f8"}
_CODECS = {
    "UNCOMPRESSED": None,
    "SNAPPY": "snappy",
    "GZIP": "gzip",
    "BROTLI": "brotli",
    "ZSTD": "zstd",
    "LZ4": "lz4_raw",
    "LZ4_RAW": "lz4_raw",
}


@dataclass(frozen=True)
class PageHeader:
    """Where a data page lies, and how it is written.

    Attributes:
        position: Offset of its content in the file.
        stored_bytes: Length of its content in the file.
        content_bytes: The same after decompression.
        entries: Values and nulls that it holds.
        encoding: Parquet's number of the encoding of its values.
        level_bytes: Lengths of the repetition and definition levels of a page of version 2, else None.
        compressed: Whether the values are compressed.
    """

    position: int
    stored_bytes: int
    content_bytes: int
    entries: int
    encoding: int
    level_bytes: tuple[int, int] | None
    compressed: bool


@dataclass(frozen=True)
class DecodedPage:
    """Content of a page.

    Attributes:
        starts: (r,) entries at which a row begins, ascending.
        present: (entries,) whether each entry has a value; None where all have.
        values: (v,) the values, a numpy array or a pyarrow array of bytes.
    """

    starts: Ints
    present: Bools | None
    values: Any

    def slice(self, start: int, stop: int) -> Any:
        """Return the values of the entries from `start` to before `stop`."""
        if self.present is not None:
            before = int(np.count_nonzero(self.present[:start]))
            start, stop = before, before + int(np.count_nonzero(self.present[start:stop]))
        return self.values[start:stop]


class ColumnChunk:
    """One column of one row group. Headers of its pages are read when a page behind them is wanted.

    Attributes:
        entries: Values and nulls that it holds, as the file's footer says.
    """

    def __init__(self, path: Path, metadata: Any, column: Any, where: str) -> None:
        """Take the description of a chunk from pyarrow.

        Args:
            path: The Parquet file.
            metadata: pyarrow's `ColumnChunkMetaData`.
            column: pyarrow's `ColumnSchema`.
            where: File and column, for messages.
        """
        self._path, self._where = path, where
        self._most_repetition = column.max_repetition_level
        self._most_definition = column.max_definition_level
        self._type = str(metadata.physical_type)
        codec = str(metadata.compression)
        if codec not in _CODECS or self._type not in _TYPES:
            raise BadInput(
                f"{where} holds {self._type} compressed by {codec}, which cannot be read in part; "
                "write the file again with zstd"
            )
        self._codec = _CODECS[codec]
        starts = [metadata.data_page_offset, metadata.dictionary_page_offset or 0]
        begin = min(start for start in starts if start > 0) if max(starts) > 0 else -1
        self._end = begin + int(metadata.total_compressed_size)
        if not 4 <= begin <= self._end <= _size(path):
            raise self._damage(f"its footer puts the column at bytes {begin} to {self._end}")
        self.entries = int(metadata.num_values)
        self._next = begin  # where the first header lies that was not read yet
        self._pages: list[PageHeader] = []
        self._first_entries: list[int] = [0]
        self._dictionary: bytes | None = None
        self._dictionary_header: tuple[PageHeader, int] | None = None
        self._decoded: OrderedDict[int, DecodedPage] = OrderedDict()
        self._lock = threading.Lock()

    def _damage(self, what: str) -> BadInput:
        return BadInput(f"{self._where}: {what}, which is no whole Parquet column; copy the file again")

    def read(self, start: int, stop: int) -> list[Any]:
        """Return the values of the entries of one row, in parts.

        Args:
            start: First entry of the row.
            stop: Entry after the last.

        Raises:
            BadInput: The file is damaged, or no row begins at `start` and ends at `stop`.
        """
        parts = []
        entry = start
        with self._file() as file:
            while entry < stop:
                number = self._page_number(file, entry)
                page, first = self._page(file, number), self._first_entries[number]
                begin, end = entry - first, min(stop - first, self._pages[number].entries)
                rows = page.starts[
                    np.searchsorted(page.starts, begin) : np.searchsorted(page.starts, end, "right")
                ]
                expected = ([begin] if entry == start else []) + (
                    [end] if end == stop - first and end < self._pages[number].entries else []
                )
                if rows.tolist() != expected:
                    raise self._damage(f"no row lies at the values {start} to {stop}")
                parts.append(page.slice(begin, end))
                entry = first + end
        return parts

    def forget(self) -> None:
        """Let go of decoded pages; they are read again when they are wanted."""
        with self._lock:
            self._decoded.clear()
            self._dictionary = None

    def row_starts(self) -> Ints:
        """Return the entries at which the rows begin; reads the whole column."""
        starts = []
        with self._file() as file:
            entry = 0
            while entry < self.entries:
                number = self._page_number(file, entry)
                starts.append(self._page(file, number).starts + entry)
                entry += self._pages[number].entries
        return np.concatenate([*starts, np.zeros(0, np.int64)])

    def _file(self) -> IO[bytes]:
        try:
            return self._path.open("rb", buffering=0)
        except OSError as error:
            raise unreadable(self._path, error) from None

    def _page_number(self, file: IO[bytes], entry: int) -> int:
        """Return the number of the page of an entry; reads headers up to it."""
        with self._lock:
            while self._first_entries[-1] <= entry:
                if entry >= self.entries or self._next >= self._end:
                    raise self._damage(f"it ends after {self._first_entries[-1]} of {self.entries} values")
                self._read_header(file)
            return bisect_right(self._first_entries, entry) - 1

    def _read_header(self, file: IO[bytes]) -> None:
        fields, position = self._header_fields(file)
        kind, content_bytes, stored_bytes = (_number(fields, field) for field in (1, 2, 3))
        if not 0 <= stored_bytes <= self._end - position or not 0 <= content_bytes <= _MOST_PAGE_BYTES:
            raise self._damage(f"a page of {stored_bytes} and {content_bytes} bytes begins at {self._next}")
        self._next = position + stored_bytes
        if kind == _INDEX_PAGE:
            return
        inner = fields.get({_DATA_PAGE: 5, _DICTIONARY_PAGE: 7, _DATA_PAGE_V2: 8}.get(kind, -1))
        if not isinstance(inner, dict):
            raise self._damage(f"a page of kind {kind} ends at byte {position}")
        entries = _number(inner, 1)
        if not 0 <= entries <= _MOST_PAGE_VALUES:
            raise self._damage(f"a page of {entries} values ends at byte {position}")
        lengths, compressed, encoding = None, self._codec is not None, _number(inner, 2)
        if kind == _DATA_PAGE_V2:
            lengths, encoding = (_number(inner, 6), _number(inner, 5)), _number(inner, 4)
            compressed &= bool(inner.get(7, True))
            if min(lengths) < 0 or sum(lengths) > min(stored_bytes, content_bytes):
                raise self._damage(f"a page has levels of {lengths} bytes")
        page = PageHeader(position, stored_bytes, content_bytes, entries, encoding, lengths, compressed)
        if kind == _DICTIONARY_PAGE:
            self._dictionary_header = (page, entries)
        else:
            self._pages.append(page)
            self._first_entries.append(self._first_entries[-1] + entries)

    def _header_fields(self, file: IO[bytes]) -> tuple[Fields, int]:
        for count in _HEADER_BYTES:
            content = self._bytes(file, self._next, min(count, self._end - self._next))
            try:
                fields, length = read_struct(content, 0)
                return fields, self._next + length
            except ShortInput:
                continue
            except ValueError as error:
                raise self._damage(f"at byte {self._next} {error}") from None
        raise self._damage(f"no page begins at byte {self._next}")

    def _bytes(self, file: IO[bytes], position: int, count: int) -> bytes:
        content = read_at(file, position, count)
        if len(content) < count:
            raise self._damage(f"the file ends before byte {position + count}")
        return content

    def _page(self, file: IO[bytes], number: int) -> DecodedPage:
        with self._lock:
            if number in self._decoded:
                self._decoded.move_to_end(number)
                return self._decoded[number]
        page = self._decode(file, self._pages[number])
        if page.values.nbytes + page.starts.nbytes <= _MOST_CACHED_BYTES:
            with self._lock:
                self._decoded[number] = page
                while len(self._decoded) > _CACHED_PAGES:
                    self._decoded.popitem(last=False)
        return page

    def _decode(self, file: IO[bytes], page: PageHeader) -> DecodedPage:
        stored = self._bytes(file, page.position, page.stored_bytes)
        widths = (self._most_repetition.bit_length(), self._most_definition.bit_length())
        levels: list[LevelRuns | None] = []
        if page.level_bytes is not None:
            middle, end = page.level_bytes[0], sum(page.level_bytes)
            blocks = [memoryview(stored)[:middle], memoryview(stored)[middle:end]]
            content = self._decompressed(memoryview(stored)[end:], page.content_bytes - end, page.compressed)
        else:
            content = self._decompressed(memoryview(stored), page.content_bytes, page.compressed)
            blocks = []
            for width in widths:
                length = int.from_bytes(content[:4], "little") if width else 0
                if width and length > len(content) - 4:
                    raise self._damage(f"the page at byte {page.position} has levels of {length} bytes")
                blocks.append(content[4 : 4 + length])
                content = content[4 + length :] if width else content
        for block, width in zip(blocks, widths, strict=True):
            try:
                levels.append(read_levels(block, width, page.entries) if width else None)
            except ValueError:
                raise self._damage(f"the page at byte {page.position} lacks levels") from None
        repetition, definition = levels
        starts = np.arange(page.entries) if repetition is None else repetition.positions(0)
        present = None
        if definition is not None and not definition.all_equal(self._most_definition):
            present = definition.expanded() == self._most_definition
        count = page.entries if present is None else int(np.count_nonzero(present))
        return DecodedPage(starts, present, self._values(file, page, content, count))

    def _decompressed(self, content: memoryview, length: int, compressed: bool) -> memoryview:
        if not compressed or length == 0:
            return content
        try:
            found = memoryview(pa.decompress(pa.py_buffer(content), length, codec=self._codec)).cast("B")
        except (pa.ArrowException, OSError, MemoryError) as error:
            raise self._damage(one_line(error)[:120]) from None
        if len(found) != length:
            raise self._damage(f"a page has {len(found)} bytes, expected {length}")
        return found

    def _values(self, file: IO[bytes], page: PageHeader, content: memoryview, count: int) -> Any:
        plain = _PLAIN_TYPES.get(self._type)
        if page.encoding == _PLAIN and plain:
            if count * np.dtype(plain).itemsize > len(content):
                raise self._damage(f"a page has {len(content)} bytes for {count} values")
            return np.frombuffer(content, plain, count)
        if count == 0:
            return np.zeros(0, plain) if plain else pa.array([], pa.binary())
        pages = [self._dictionary_page(file)] if page.encoding in (_PLAIN_DICTIONARY, _RLE_DICTIONARY) else []
        header = {1: _DATA_PAGE, 2: len(content), 3: len(content)}
        header[5] = {1: count, 2: page.encoding, 3: _RLE, 4: _RLE}  # type: ignore[assignment]
        pages.append(write_struct(header) + content)
        single = single_column_file(pages, _TYPES[self._type], count)
        try:
            # Equal byte strings stay one: a page of a thousand equal pictures is small.
            equal = ["x"] if len(pages) == 2 and not plain else None
            reader = pq.ParquetFile(pa.BufferReader(single), read_dictionary=equal)
            column = reader.read(use_threads=False).column(0)
            column = column.chunk(0) if column.num_chunks == 1 else pa.concat_arrays(column.chunks)
            column.validate()
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise self._damage(f"a page cannot be decoded ({one_line(error)[:120]})") from None
        if len(column) != count:
            raise self._damage(f"a page has {len(column)} values, expected {count}")
        return column.to_numpy() if plain else column

    def _dictionary_page(self, file: IO[bytes]) -> bytes:
        if self._dictionary is None:
            if self._dictionary_header is None:
                raise self._damage("a page needs a dictionary, and the column has none")
            page, entries = self._dictionary_header
            stored = self._bytes(file, page.position, page.stored_bytes)
            content = self._decompressed(memoryview(stored), page.content_bytes, page.compressed)
            header = {1: _DICTIONARY_PAGE, 2: len(content), 3: len(content), 7: {1: entries, 2: _PLAIN}}
            self._dictionary = write_struct(header) + content
        return self._dictionary


def _number(fields: Fields, number: int) -> int:
    value = fields.get(number, -1)
    return value if isinstance(value, int) else -1


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise unreadable(path, error) from None
