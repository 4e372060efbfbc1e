"""The shards of a stage as its folder lists them: names, sizes and versions in arrays, no file opened."""

from __future__ import annotations

import os
from array import array
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from upvl_cli.errors import UpvlError, one_line
from upvl_cli.pipeline.catalog.hashing import Hashes, combine, text_hashes
from upvl_cli.pipeline.storage.listing import list_objects
from upvl_cli.pipeline.storage.remote_path import RemotePath

_SUFFIX = ".parquet"
_PART_NAMES, _MOST_PARTS = (
    20_000,
    16,
)  # a part has twenty pages or more: where it ends is not known to the store


@dataclass(frozen=True)
class Listing:
    """The shards of one stage.

    Attributes:
        segment: n names.
        size_bytes: (n,) sizes.
        version: (n,) hashes that differ where a file was replaced or written to; never 0.
        tag: n versions as an object store has them; None on a disk.
    """

    segment: pa.StringArray
    size_bytes: npt.NDArray[np.int64]
    version: Hashes
    tag: pa.StringArray | None = None


def list_shards(folder: Path, segments: pa.Array) -> Listing:
    """List the shards of a folder; none where there is no folder.

    Args:
        folder: The folder of a stage.
        segments: Names of the drives: where there are many, a folder of an object store is listed in parts.

    Raises:
        UpvlError: The folder cannot be listed.
    """
    if isinstance(folder, RemotePath):
        return _list_remote(folder, segments)
    try:
        return _list_local(folder)
    except OSError as error:
        raise UpvlError(f"cannot list {folder}: {error.strerror or one_line(error)}") from error


def _list_local(folder: Path) -> Listing:
    names: list[str] = []
    # A file that was moved into place has another inode; one that was written to has another time of change, which
    # the system itself keeps.
    state = [array("q") for _ in range(4)]
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.endswith(_SUFFIX) or entry.name.startswith("."):
                    continue
                try:
                    found = entry.stat()
                except FileNotFoundError:  # removed meanwhile, or a link that leads nowhere
                    continue
                names.append(entry.name[: -len(_SUFFIX)])
                state[0].append(found.st_size)
                state[1].append(found.st_mtime_ns)
                state[2].append(found.st_ctime_ns)
                state[3].append(found.st_ino & (2**63 - 1))
    except (FileNotFoundError, NotADirectoryError):
        pass
    columns = [np.frombuffer(column, dtype=np.int64) if column else np.zeros(0, np.int64) for column in state]
    version = combine([column.view(np.uint64) for column in columns], len(names))
    return Listing(pa.array(names, pa.string()), columns[0], np.maximum(version, np.uint64(1)))


def _list_remote(folder: RemotePath, segments: pa.Array) -> Listing:
    parts = max(min(_MOST_PARTS, len(segments) // _PART_NAMES), 1)
    names = [segments[len(segments) * part // parts].as_py() for part in range(1, parts)]
    splits = sorted({f"{name}{_SUFFIX}" for name in names})
    found = list_objects(folder, _SUFFIX, splits)
    names, tags = (found[column].combine_chunks() for column in ("name", "e_tag"))
    size_bytes = found["size"].to_numpy()
    return Listing(
        names, size_bytes, object_versions(tags, size_bytes, found["last_modified"].to_numpy()), tags
    )


def object_versions(
    tags: pa.Array, size_bytes: npt.NDArray[np.int64], modified_ns: npt.NDArray[np.int64]
) -> Hashes:
    """Return the (n,) versions of n objects, by their entity tags; by their times where a store gives none."""
    times = np.where(tags.is_null().to_numpy(zero_copy_only=False), modified_ns, 0)
    columns = [text_hashes(tags), size_bytes.view(np.uint64), times.view(np.uint64)]
    return np.maximum(combine(columns, len(tags)), np.uint64(1))
