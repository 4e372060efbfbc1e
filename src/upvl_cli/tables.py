"""Parquet shards: written whole or not at all, read by frame, each with the stamp of what made it."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import stat
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.errors import NotMade, UpvlError, one_line
from upvl_cli.stage import Column, Row, columns_of
from upvl_cli.types import Array

STAMP_KEY = b"upvl.stamp"
COUNTS_KEY = b"upvl.counts"


def schema_of(row: type[Row]) -> pa.Schema:
    """The Arrow schema that follows from a row's declaration."""

    def arrow(spec: Column) -> pa.DataType:
        if spec.shape and spec.type == "int8":
            return (
                pa.binary()
            )  # Parquet has no integers of one byte: a list would take four each, and their time
        kind = pa.type_for_alias(spec.type)
        return pa.list_(kind) if spec.is_array else kind

    return pa.schema([pa.field(name, arrow(spec), nullable=False) for name, spec in columns_of(row).items()])


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
        How many rows were written; None where the shard was not needed any more.

    Raises:
        UpvlError: The folder cannot be written or the disk is full.
    """
    schema = schema_of(row)
    with whole(path) as file:
        if not needed():
            raise _NotNeeded
        with pq.ParquetWriter(
            file, schema, compression="zstd", use_dictionary=False, write_page_checksum=True
        ) as writer:
            written = 0
            for item in rows:
                writer.write_batch(_batch(item, schema))
                written += 1
            writer.add_key_value_metadata(
                {STAMP_KEY: stamp.encode(), COUNTS_KEY: json.dumps(dict(counts), sort_keys=True).encode()}
            )
        return written
    return None


class _NotNeeded(Exception):  # noqa: N818
    """Leaves `whole` without a file and without an error."""


@contextlib.contextmanager
def whole(path: Path) -> Iterator[IO[bytes]]:
    """A binary file that appears at `path` only when the block ends well.

    A second process that wants the same path waits until the first is done.

    Raises:
        UpvlError: The folder cannot be written or the disk is full.
    """
    part = path.with_name(f".{path.name}.part")
    for place in (path, part):
        if place.is_dir() and not place.is_symlink():
            raise UpvlError(f"{place} is a folder where a file belongs; remove it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _removed_on_failure(part), _locked(part) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            part.replace(path)
    except _NotNeeded:
        return
    except OSError as error:
        raise UpvlError(
            f"cannot write {path}: {error.strerror or one_line(error)}; make room or make the folder writable, "
            "or choose another with --out"
        ) from error


@contextlib.contextmanager
def _locked(part: Path) -> Iterator[IO[bytes]]:
    """The part file, emptied, held against other processes; a killed process holds nothing."""
    while True:
        if part.is_symlink() or (part.exists() and not _ours(part.stat())):
            part.unlink()  # a link or a pipe: writing would end up elsewhere
        with os.fdopen(os.open(part, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            if _is_at(file, part):
                file.truncate(0)
                yield file
                return
        # the one that held it has moved it into place


@contextlib.contextmanager
def _removed_on_failure(part: Path) -> Iterator[None]:
    """Removes the part file after an error or a Ctrl-C at any moment, unless another process holds it."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError), part.open("r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(file, part):
                part.unlink()
        raise


def _is_at(file: IO[bytes], path: Path) -> bool:
    return path.exists() and path.stat().st_ino == os.fstat(file.fileno()).st_ino


def _ours(found: os.stat_result) -> bool:
    return stat.S_ISREG(found.st_mode) and found.st_nlink == 1


def _batch(item: Row, schema: pa.Schema) -> pa.RecordBatch:
    declared = columns_of(type(item))
    lengths: dict[str, int] = {}
    arrays = []
    for name, spec in declared.items():
        value = getattr(item, name)
        arrays.append(_pack(name, value, spec, schema.field(name).type, lengths))
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _pack(name: str, value: Any, spec: Column, kind: pa.DataType, lengths: dict[str, int]) -> pa.Array:
    if not spec.is_array:
        return pa.array([value], type=kind)
    values = np.ascontiguousarray(value)
    expected = (lengths.setdefault(spec.per, len(values)), *spec.shape) if spec.per else spec.shape
    # A wrong shape is a bug in the stage, not the user's fault: it keeps its traceback.
    if values.shape != expected:
        raise ValueError(f"column {name} has shape {values.shape}, expected {expected}")
    flat = values.reshape(-1)
    if np.issubdtype(flat.dtype, np.floating) and not np.isfinite(flat).all():
        raise ValueError(f"column {name} holds NaN or infinite values")
    if pa.types.is_binary(kind):
        return pa.array([flat.astype(spec.type, copy=False).tobytes()], type=kind)
    dtype = np.dtype(kind.value_type.to_pandas_dtype())
    items = pa.array(flat.astype(dtype, copy=False), type=kind.value_type)
    return pa.ListArray.from_arrays(pa.array([0, len(flat)], pa.int32()), items, type=kind)


class Table:
    """A shard opened for reading: `table[frame]` gives the row of that frame."""

    def __init__(self, path: Path, row: type[Row]) -> None:
        """Open a shard.

        Raises:
            NotMade: It is missing, is not a whole Parquet file, or has other columns.
        """
        self._row = row
        self._path = path
        self._file = _open(path)
        missing = [name for name in columns_of(row) if name not in self._file.schema_arrow.names]
        if missing:
            raise NotMade(f"{path} has no column {', '.join(missing)}: delete it and make it again")
        self._group_of = {frame: group for group, frame in enumerate(_frames(self._file.metadata, path))}
        self._lock = threading.Lock()  # a Parquet file has one reading position

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that have a row, ascending."""
        return tuple(self._group_of)

    def __len__(self) -> int:
        return len(self._group_of)

    def __iter__(self) -> Iterator[Any]:
        return (self[frame] for frame in self._group_of)

    def __getitem__(self, frame: int) -> Any:
        names = [spec.name for spec in fields(self._row)]
        with self._lock, _damage_told(self._path):
            group = self._file.read_row_group(self._group_of[frame], columns=names, use_threads=False)
        return self._row(
            **{name: _unpack(group.column(name), spec) for name, spec in columns_of(self._row).items()}
        )


def _unpack(values: pa.ChunkedArray, spec: Column) -> Any:
    if not spec.is_array:
        return values[0].as_py()
    flat: Array
    if pa.types.is_binary(values.type):
        flat = np.frombuffer(values[0].as_buffer(), dtype=spec.type)
    else:
        flat = values.chunk(0).values.to_numpy(zero_copy_only=False)
    shape = (-1, *spec.shape) if spec.per else spec.shape
    return flat.reshape(shape) if flat.size or not spec.per else flat.reshape(0, *spec.shape)


def _open(path: Path) -> pq.ParquetFile:
    if not path.exists():
        raise NotMade(f"{path} has not been made; run: make {path.parent.name}")
    with _damage_told(path):
        return pq.ParquetFile(path, page_checksum_verification=True)


def _frames(metadata: pq.FileMetaData, path: Path) -> Iterator[int]:
    """The frame of each row, which is a group of its own: the footer has it as the group's bound."""
    (place,) = (n for n in range(metadata.num_columns) if metadata.schema.column(n).path == "frame")
    for group in range(metadata.num_row_groups):
        bounds = metadata.row_group(group).column(place).statistics
        if bounds is None or not bounds.has_min_max:
            raise NotMade(
                f"{path} is damaged (a row without a number of its frame); delete it and make it again"
            )
        yield bounds.min


@contextlib.contextmanager
def _damage_told(path: Path) -> Iterator[None]:
    """Says which shard it is that cannot be read."""
    try:
        yield
    except (pa.ArrowException, OSError) as error:
        raise NotMade(f"{path} is damaged ({one_line(error)}); delete it and make it again") from None


@dataclass(frozen=True)
class Footer:
    """What a shard says of itself: its stamp, how many items it kept and dropped, its rows."""

    stamp: str
    counts: dict[str, int]
    rows: int


def read_footer(path: Path) -> Footer | None:
    """The footer of a shard, or None where there is no whole shard."""
    try:
        metadata = pq.read_metadata(path)
        pairs = metadata.metadata or {}
        stamp, counts = pairs[STAMP_KEY].decode(), json.loads(pairs[COUNTS_KEY])
        json.loads(stamp)
        return Footer(stamp, {str(reason): int(items) for reason, items in counts.items()}, metadata.num_rows)
    except (OSError, pa.ArrowException, KeyError, ValueError, AttributeError, TypeError, RecursionError):
        return None


def footer_digest(path: Path) -> str:
    """A digest of what a shard's footer says, sizes and bounds of every column included; "" without a shard.

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
