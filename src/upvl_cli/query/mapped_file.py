"""A file that is read as memory, whose pages can be given back."""

from __future__ import annotations

import mmap
import os

import numpy as np

from upvl_cli.types import Array


class MappedFile:
    """A file mapped into memory: what is read of it stays there until it is released."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Map a file.

        Args:
            path: The file.

        Raises:
            OSError: It cannot be read.
            ValueError: It is empty.
        """
        with open(path, "rb") as file:
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._begin = np.frombuffer(self._map, np.uint8).ctypes.data

    @property
    def buffer(self) -> memoryview:
        """The bytes of the file."""
        return memoryview(self._map)

    def release(self, values: Array) -> None:
        """Give back the memory of an array that is a view of this file; it is read again when it is next used.

        Args:
            values: A contiguous array; one that lies elsewhere is left alone.
        """
        begin = values.ctypes.data - self._begin
        end = begin + values.nbytes
        first, last = -(-begin // mmap.PAGESIZE) * mmap.PAGESIZE, end // mmap.PAGESIZE * mmap.PAGESIZE
        if begin >= 0 and end <= len(self._map) and first < last and hasattr(self._map, "madvise"):
            self._map.madvise(mmap.MADV_DONTNEED, first, last - first)
