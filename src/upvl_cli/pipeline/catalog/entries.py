"""What a shard's footer says, in a few numbers that can be compared for a million shards at once."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.errors import StorageError
from upvl_cli.pipeline.catalog.hashing import combine, digest_prefix, text_hash
from upvl_cli.pipeline.provenance import to_json
from upvl_cli.pipeline.storage.remote_path import RemotePath
from upvl_cli.pipeline.tables import footer_digest_of, footer_of
from upvl_cli.runtime.parallel import threads

# Of each shard: the version of its file in the listing, its size, the number of its frames, and hashes of its footer
# and of the parts of its stamp.
ENTRY = np.dtype(
    [
        ("version", np.uint64),
        ("size_bytes", np.int64),
        ("rows", np.int64),
        ("footer", np.uint64),
        ("settings", np.uint64),
        ("raw", np.uint64),
        ("files", np.uint64),
        ("inputs", np.uint64),
    ]
)
Entries = npt.NDArray[np.void]
NOT_LISTED, DAMAGED = -2, -1  # in place of the number of rows
_TAIL_BYTES = 65_536  # read at once: most footers have less
_REQUESTS = 32  # to an object store at a time: reading a footer is waiting


class Shard(NamedTuple):
    """A shard as it was listed.

    Attributes:
        path: Its path.
        size_bytes: Its size.
        tag: Its version in an object store; empty on a disk.
    """

    path: Path
    size_bytes: int
    tag: str


class StampParts(NamedTuple):
    """The parts of a stamp that are compared for themselves.

    Attributes:
        settings: Hash of the stamp without the other parts, with the names of its inputs.
        raw: Digest of the content of the drive; of each drive for a shard of the whole dataset.
        files: Digest of the files that the settings name; empty without any.
        inputs: Digest of the footer of each input.
    """

    settings: int
    raw: str | Mapping[str, str]
    files: str
    inputs: Mapping[str, str]


def settings_text(makers: Mapping[str, Any], inputs: Sequence[str]) -> str:
    """Return what is the same in the stamps of all shards of a stage that were made with the same values.

    Args:
        makers: The settings and versions of the stage and of those before it, the dataset's adapter as `raw`.
        inputs: Names of the inputs.
    """
    adapter = {key: value for key, value in makers["raw"].items() if key != "content"}
    return to_json({**makers, "raw": adapter, "inputs": sorted(inputs)})


def stamp_parts(stamp: str) -> StampParts:
    """Return the parts of a stamp.

    Raises:
        ValueError: The text is none that a stage writes.
    """
    try:
        made = json.loads(stamp)
        if to_json(made) != stamp:
            raise ValueError("the same values in another text")
        raw, files, inputs = made["raw"]["content"], made.pop("files", None), made.pop("inputs")
        if files is not None and set(files) != {"content"}:
            raise ValueError("files without a digest")
        return StampParts(
            text_hash(settings_text(made, list(inputs))), raw, files["content"] if files else "", inputs
        )
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError("no stamp of a shard") from error


def read_tail(shard: Shard) -> bytes:
    """Return the last bytes of a file, the footer of a Parquet file among them; raises `OSError` or `StorageError`."""
    if isinstance(shard.path, RemotePath):
        bucket, key = shard.path.bucket, shard.path.key

        def read_end(length: int) -> bytes:
            return bucket.read(key, shard.size_bytes - length, length, shard.tag) if length else b""

        return _tail(read_end, shard.size_bytes)
    with shard.path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)

        def read_end_of_file(length: int) -> bytes:
            file.seek(size - length)
            return file.read(length)

        return _tail(read_end_of_file, size)


def _tail(read_end: Callable[[int], bytes], size: int) -> bytes:
    tail = read_end(min(size, _TAIL_BYTES))
    length = int.from_bytes(tail[-8:-4], "little") + 8
    return tail[-length:] if length <= len(tail) else read_end(min(size, length))


def entry_of(tail: bytes) -> tuple[Any, ...]:
    """Return the entry of a shard from the end of its file; its version and size are not known yet."""
    try:
        footer = footer_of(pq.read_metadata(pa.BufferReader(tail)))
    except (OSError, pa.ArrowException):
        footer = None
    if footer is None:
        return 0, 0, DAMAGED, 0, 0, 0, 0, 0
    digest = digest_prefix(footer_digest_of(io.BytesIO(tail)))
    try:
        settings, raw, files, inputs = stamp_parts(footer.stamp)
        content = digest_prefix(raw) if isinstance(raw, str) else 0
        of_inputs = [np.array([digest_prefix(inputs[name])], dtype=np.uint64) for name in sorted(inputs)]
        return (
            0,
            0,
            footer.rows,
            digest,
            settings,
            content,
            digest_prefix(files),
            int(combine(of_inputs, 1)[0]),
        )
    except (ValueError, TypeError):  # a stamp that equals none
        return 0, 0, footer.rows, digest, 0, 0, 0, 0


def read_entries(shards: Sequence[Shard], tick: Callable[[], None]) -> Iterator[tuple[Any, ...] | None]:
    """Yield the entry of each shard, in order, their footers read by threads; None for one that cannot be read.

    Args:
        shards: Few enough to hold their entries.
        tick: Called after each.

    Raises:
        StorageError: An object store does not answer.
    """
    is_far = bool(shards) and isinstance(shards[0].path, RemotePath)
    with ThreadPoolExecutor(_REQUESTS if is_far else threads()) as pool:
        for entry in pool.map(_read_entry, shards):
            tick()
            yield entry


def _read_entry(shard: Shard) -> tuple[Any, ...] | None:
    try:
        return entry_of(read_tail(shard))
    except OSError:
        return None
    except StorageError:
        info = shard.path.look() if isinstance(shard.path, RemotePath) else None
        if info is not None and info.version == shard.tag:
            raise
        return None  # replaced since it was listed: what it is now, the next listing says
