"""Parquet shards: written whole or not at all, read by frame, each with the stamp of what made it.

A table of points has one row a frame. A table of boxes has one row a box, with one column a number, so that any
tool can read it; the frames without a box stand in the footer. Several frames share a row group: whoever opens a
shard holds its footer, which has half a kilobyte for each column of each row group.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Generic, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.errors import NotMade, one_line
from upvl_cli.pipeline.packing import (
    pack_box_row,
    pack_frame_row,
    scalars_of,
    schema_of,
    unpack_box_row,
    unpack_frame_row,
)
from upvl_cli.pipeline.stage import Row
from upvl_cli.pipeline.storage.remote_path import is_remote
from upvl_cli.runtime.atomic import NotNeeded, atomic_file
from upvl_cli.runtime.parallel import threads
from upvl_cli.types import Ints

STAMP_KEY = b"upvl.stamp"
COUNTS_KEY = b"upvl.counts"
FRAMES_KEY = b"upvl.frames"
CONTENT_KEY = b"upvl.content"
# A row group is read whole. 64 frames of boxes are some 100 kilobytes, and 4 000 frames 63 groups; two megabytes are
# two frames of the features of points, or eight of their heights.
GROUP_FRAMES = 64
GROUP_BYTES = 2**21

R = TypeVar("R", bound=Row)
FrameEntry = tuple[int, int, dict[str, object]]  # its number, how many rows of the table it has, its scalars


def write(
    path: Path,
    row: type[Row],
    rows: Iterable[Row],
    *,
    stamp: str,
    counts: Mapping[str, int],
    needed: Callable[[], bool] = lambda: True,
) -> int | None:
    """Write a shard beside its place and move it there when it is whole.

    Args:
        path: Where the shard goes.
        row: The declared row.
        rows: The rows, in ascending order of frames; `counts` may grow while they are made.
        stamp: JSON of all that makes the shard what it is.
        counts: How many items were kept and dropped, by reason.
        needed: Asked once no other process writes the same shard; it may have been made meanwhile.

    Returns:
        How many frames were written; None where the shard was not needed any more.

    Raises:
        UpvlError: The folder cannot be written or the disk is full.
    """
    schema = schema_of(row)
    with atomic_file(path, one_writer=True) as file:
        if not needed():
            raise NotNeeded
        digested = _DigestedFile(file)
        frames: list[FrameEntry] = []
        with pq.ParquetWriter(
            digested, schema, compression="zstd", use_dictionary=False, write_page_checksum=True
        ) as writer:
            for group in _row_groups(rows, schema, frames):
                writer.write_table(group, row_group_size=group.num_rows)
            writer.add_key_value_metadata(
                {
                    STAMP_KEY: stamp.encode(),
                    COUNTS_KEY: json.dumps(dict(counts), sort_keys=True).encode(),
                    FRAMES_KEY: json.dumps(frames).encode(),
                    CONTENT_KEY: digested.digest.hexdigest().encode(),
                }
            )
        return len(frames)
    return None


def _row_groups(rows: Iterable[Row], schema: pa.Schema, frames: list[FrameEntry]) -> Iterator[pa.Table]:
    """Yield the rows of a few frames at a time, and note each frame in `frames`."""
    batches: list[pa.RecordBatch] = []
    for item in rows:
        batch = (pack_box_row if item.per_box else pack_frame_row)(item, schema)
        frames.append((item.frame, batch.num_rows, scalars_of(item)))
        batches += [batch] if batch.num_rows else []
        if len(batches) == GROUP_FRAMES or sum(held.nbytes for held in batches) >= GROUP_BYTES:
            yield pa.Table.from_batches(batches, schema)
            batches = []
    if batches:
        yield pa.Table.from_batches(batches, schema)


class _DigestedFile(io.RawIOBase):
    """A file to write to, and the digest of what was written.

    Of two shards with other values the footers differ by it; bounds and sizes of row groups could be the same.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.digest = hashlib.sha256()

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.digest.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        return self._file.tell()


class Table(Generic[R]):
    """A shard opened for reading: `table[frame]` gives the row of that frame."""

    def __init__(self, path: Path, row: type[R], held_groups: int = 0) -> None:
        """Open a shard.

        Args:
            path: The shard.
            row: The row that its stage declares.
            held_groups: Row groups that stay in memory at least, for one who reads frames in no order.

        Raises:
            NotMade: It is missing, is not a whole Parquet file, or has other columns.
        """
        self._row = row
        self._path = path
        self._file = _open(path)
        self._schema = schema_of(row)
        missing = [name for name in self._schema.names if name not in self._file.schema_arrow.names]
        footer = footer_of(self._file.metadata)
        if missing or footer is None:
            fault = (
                f"has no column {', '.join(missing)}" if missing else "is damaged (its footer says nothing)"
            )
            raise NotMade(f"{path} {fault}; delete it and make it again")
        self._frames = _FrameIndex.of_footer(footer)
        metadata = self._file.metadata
        groups = [metadata.row_group(number).num_rows for number in range(metadata.num_row_groups)]
        self._group_start = np.concatenate([[0], np.cumsum(groups, dtype=np.int64)])
        self._segment = path.stem
        self._lock = threading.Lock()  # a Parquet file has one reading position
        self._held: OrderedDict[int, pa.Table] = OrderedDict()
        # As many consecutive frames are worked on at a time as there are threads, and one waits.
        in_order = 1 + -(-(threads() + 1) * len(groups) // max(len(footer.frames), 1))
        self._max_held = max(in_order, held_groups)

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that have a row, ascending."""
        return tuple(self._frames.frame.tolist())

    def __len__(self) -> int:
        return len(self._frames.frame)

    def __iter__(self) -> Iterator[R]:
        return (self[frame] for frame in self._frames.frame.tolist())

    def __getitem__(self, frame: int) -> R:
        place = self._frames.place(frame)
        columns = self._rows(int(self._frames.start[place]), int(self._frames.start[place + 1]))
        if self._row.per_box:
            scalars = {name: values[place] for name, values in self._frames.scalars.items()}
            return unpack_box_row(self._row, columns, self._segment, int(frame), scalars)
        return unpack_frame_row(self._row, columns)

    def _rows(self, first: int, end: int) -> pa.Table:
        """Return some rows of one row group; the groups read last are held, as the next frame lies in one of them."""
        if first == end:
            return self._schema.empty_table()
        group = int(np.searchsorted(self._group_start, first, side="right")) - 1
        with self._lock, _damage_named(self._path):
            columns = self._held.pop(group, None)
            if columns is None:
                columns = self._file.read_row_group(group, columns=self._schema.names, use_threads=False)
            if columns.num_rows > end - first:
                self._held[group] = columns
            if len(self._held) > self._max_held:
                self._held.popitem(last=False)
        start = first - int(self._group_start[group])
        return columns.slice(start, end - first)


@dataclass(frozen=True)
class _FrameIndex:
    """Where the rows of each frame lie, in arrays: a drive has thousands of frames.

    Attributes:
        frame: (T,) numbers, ascending.
        start: (T + 1,) first row of each in the table, and the number of rows.
        scalars: T values of the frame by the name of their column.
    """

    frame: Ints
    start: Ints
    scalars: Mapping[str, list[Any]]

    @classmethod
    def of_footer(cls, footer: Footer) -> _FrameIndex:
        frame = np.array([number for number, _, _ in footer.frames], dtype=np.int64)
        rows = np.array([rows for _, rows, _ in footer.frames], dtype=np.int64)
        names = footer.frames[0][2] if footer.frames else {}
        scalars = {name: [values[name] for _, _, values in footer.frames] for name in names}
        return cls(frame, np.concatenate([[0], np.cumsum(rows)]), scalars)

    def place(self, frame: int) -> int:
        """Return the place of a frame; raises `KeyError` where it has none."""
        place = int(np.searchsorted(self.frame, frame))
        if place == len(self.frame) or self.frame[place] != frame:
            raise KeyError(frame)
        return place


def _open(path: Path) -> pq.ParquetFile:
    try:
        source = _source(path)
    except FileNotFoundError:
        raise NotMade(f"{path} has not been made; run: make {path.parent.name}") from None
    with _damage_named(path):
        # Of an object the columns of a row group are fetched together.
        return pq.ParquetFile(source, page_checksum_verification=True, pre_buffer=source is not path)


def _source(path: Path) -> Path | IO[bytes]:
    """Return what Arrow opens: a local file by its path; an object opened, of which only what is read is fetched.

    Raises:
        FileNotFoundError: It has not been made.
    """
    if is_remote(path):
        return path.open("rb")
    if not path.exists():
        raise FileNotFoundError(path)
    return path


@contextlib.contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Says which shard it is that cannot be read."""
    try:
        yield
    except (pa.ArrowException, OSError) as error:
        raise NotMade(f"{path} is damaged ({one_line(error)}); delete it and make it again") from None


@dataclass(frozen=True)
class Footer:
    """What a shard says of itself.

    Attributes:
        stamp: JSON of all that made it.
        counts: How many items were kept and dropped, by reason.
        frames: Of each frame its number, how many rows of the table it has, and what it has once.
    """

    stamp: str
    counts: dict[str, int]
    frames: tuple[FrameEntry, ...]

    @property
    def rows(self) -> int:
        """How many frames have a row."""
        return len(self.frames)


def read_footer(path: Path) -> Footer | None:
    """Return the footer of a shard, or None where there is no whole shard."""
    try:
        return footer_of(pq.read_metadata(_source(path)))
    except (OSError, pa.ArrowException):
        return None


def footer_of(metadata: pq.FileMetaData) -> Footer | None:
    """Return what a shard says of itself, from the metadata of its file; None where it is no whole shard."""
    try:
        pairs = metadata.metadata or {}
        stamp, counts = pairs[STAMP_KEY].decode(), json.loads(pairs[COUNTS_KEY])
        entries = json.loads(pairs[FRAMES_KEY])
        frames = tuple((int(frame), int(rows), dict(scalars)) for frame, rows, scalars in entries)
        json.loads(stamp)
        if sum(rows for _, rows, _ in frames) != metadata.num_rows:
            return None
        return Footer(stamp, {str(reason): int(items) for reason, items in counts.items()}, frames)
    except (KeyError, ValueError, AttributeError, TypeError, RecursionError):
        return None


def footer_digest(path: Path) -> str:
    """Return a digest of a shard's footer, sizes and bounds of every column included; "" without a shard.

    Stands for the content of an input: another content has another footer.
    """
    try:
        with path.open("rb") as file:
            return footer_digest_of(file)
    except OSError:
        return ""


def footer_digest_of(file: IO[bytes]) -> str:
    """Return the digest of the footer that a file ends with; raises `OSError` where there is no room for one."""
    file.seek(-8, os.SEEK_END)
    length = int.from_bytes(file.read(4), "little")
    file.seek(-8 - length, os.SEEK_END)
    return hashlib.sha256(file.read(length)).hexdigest()
