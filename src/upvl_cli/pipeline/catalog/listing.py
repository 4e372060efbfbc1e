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
from upvl_cli.pipeline.catalog.hashing import Hashes, combine

_SUFFIX = ".parquet"


@dataclass(frozen=True)
class Listing:
    """The shards of one stage.

    Attributes:
        segment: n names.
        size_bytes: (n,) sizes.
        version: (n,) hashes that differ where a file was replaced or written to; never 0.
    """

    segment: pa.StringArray
    size_bytes: npt.NDArray[np.int64]
    version: Hashes


def list_shards(folder: Path) -> Listing:
    """List the shards of a folder; none where there is no folder.

    Raises:
        UpvlError: The folder cannot be listed.
    """
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
