"""Parquet shards: written whole or not at all, read by frame, each with the stamp of what made it.

A table of points has one row a frame. A table of boxes has one row a box, with one column a number, so that any
tool can read it; the frames without a box stand in the footer.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

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
from upvl_cli.runtime.atomic import NotNeeded, atomic_file

STAMP_KEY = b"upvl.stamp"
COUNTS_KEY = b"upvl.counts"
FRAMES_KEY = b"upvl.frames"

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
    pack = pack_box_row if row.per_box else pack_frame_row
    with atomic_file(path) as file:
        if not needed():
            raise NotNeeded
        frames: list[FrameEntry] = []
        with pq.ParquetWriter(
            file, schema, compression="zstd", use_dictionary=False, write_page_checksum=True
        ) as writer:
            for item in rows:
                batch = pack(item, schema)
                if batch.num_rows:
                    writer.write_batch(batch)
                frames.append((item.frame, batch.num_rows, scalars_of(item)))
            writer.add_key_value_metadata(
                {
                    STAMP_KEY: stamp.encode(),
                    COUNTS_KEY: json.dumps(dict(counts), sort_keys=True).encode(),
                    FRAMES_KEY: json.dumps(frames).encode(),
                }
            )
        return len(frames)
    return None


class Table(Generic[R]):
    """A shard opened for reading: `table[frame]` gives the row of that frame."""

    def __init__(self, path: Path, row: type[R]) -> None:
        """Open a shard.

        Raises:
            NotMade: It is missing, is not a whole Parquet file, or has other columns.
        """
        self._row = row
        self._path = path
        self._file = _open(path)
        self._schema = schema_of(row)
        missing = [name for name in self._schema.names if name not in self._file.schema_arrow.names]
        footer = _footer_of(self._file.metadata)
        if missing or footer is None:
            fault = (
                f"has no column {', '.join(missing)}" if missing else "is damaged (its footer says nothing)"
            )
            raise NotMade(f"{path} {fault}; delete it and make it again")
        # One row group for each frame that has rows, in the order of the frames.
        groups = iter(range(self._file.metadata.num_row_groups))
        self._group_of = {frame: next(groups) if count else None for frame, count, _ in footer.frames}
        self._scalars_of = {frame: scalars for frame, _, scalars in footer.frames}
        self._segment = path.stem
        self._lock = threading.Lock()  # a Parquet file has one reading position

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that have a row, ascending."""
        return tuple(self._group_of)

    def __len__(self) -> int:
        return len(self._group_of)

    def __iter__(self) -> Iterator[R]:
        return (self[frame] for frame in self._group_of)

    def __getitem__(self, frame: int) -> R:
        group = self._group_of[frame]
        if group is None:
            return unpack_box_row(
                self._row, self._schema.empty_table(), self._segment, frame, self._scalars_of[frame]
            )
        with self._lock, _damage_named(self._path):
            columns = self._file.read_row_group(group, columns=self._schema.names, use_threads=False)
        if self._row.per_box:
            return unpack_box_row(self._row, columns, self._segment, frame, self._scalars_of[frame])
        return unpack_frame_row(self._row, columns)


def _open(path: Path) -> pq.ParquetFile:
    if not path.exists():
        raise NotMade(f"{path} has not been made; run: make {path.parent.name}")
    with _damage_named(path):
        return pq.ParquetFile(path, page_checksum_verification=True)


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
        return _footer_of(pq.read_metadata(path))
    except (OSError, pa.ArrowException):
        return None


def _footer_of(metadata: pq.FileMetaData) -> Footer | None:
    try:
        pairs = metadata.metadata or {}
        stamp, counts = pairs[STAMP_KEY].decode(), json.loads(pairs[COUNTS_KEY])
        entries = json.loads(pairs[FRAMES_KEY])
        frames = tuple((int(frame), int(rows), dict(scalars)) for frame, rows, scalars in entries)
        json.loads(stamp)
        if sum(rows > 0 for _, rows, _ in frames) != metadata.num_row_groups:
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
            file.seek(-8, os.SEEK_END)
            length = int.from_bytes(file.read(4), "little")
            file.seek(-8 - length, os.SEEK_END)
            return hashlib.sha256(file.read(length)).hexdigest()
    except OSError:
        return ""
