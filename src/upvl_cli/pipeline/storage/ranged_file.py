"""An object opened like a file, of which only what is asked for is fetched."""

from __future__ import annotations

import io
import os
from typing import Any

from upvl_cli.pipeline.storage.bucket import Bucket, ObjectInfo

# The footer of a Parquet file lies at its end: one request brings it, whatever the reader asks for first.
_TAIL_BYTES = 64 * 2**10


class RangedFile(io.RawIOBase):
    """One version of an object, read by ranges."""

    def __init__(self, bucket: Bucket, key: str, info: ObjectInfo) -> None:
        """Open a version of an object.

        Args:
            bucket: Its bucket.
            key: Its key.
            info: Its size and version.
        """
        self._bucket, self._key, self._info = bucket, key, info
        self._position = 0
        self._tail = b""

    def readable(self) -> bool:
        """Whether it can be read: always."""
        return True

    def seekable(self) -> bool:
        """Whether reading can go on elsewhere: always."""
        return True

    def tell(self) -> int:
        """Return the place of the next byte."""
        return self._position

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, and return it."""
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._info.size}[whence]
        self._position = max(origin + offset, 0)
        return self._position

    def readinto(self, buffer: Any) -> int:
        """Read bytes into a buffer, and return how many."""
        view = memoryview(buffer).cast("B")
        size = max(min(len(view), self._info.size - self._position), 0)
        if size:
            view[:size] = self._bytes(self._position, size)
            self._position += size
        return size

    def _bytes(self, start: int, size: int) -> bytes:
        begin = max(self._info.size - _TAIL_BYTES, 0)
        if start < begin:
            return self._bucket.read(self._key, start, size, self._info.version)
        if not self._tail:
            self._tail = self._bucket.read(self._key, begin, self._info.size - begin, self._info.version)
        return self._tail[start - begin : start - begin + size]
