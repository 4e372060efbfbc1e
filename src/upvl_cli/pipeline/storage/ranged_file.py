"""An object opened like a file, of which only what is asked for is fetched."""

from __future__ import annotations

from typing import Any

from upvl_cli.pipeline.storage.bucket import Bucket, ObjectInfo
from upvl_cli.pipeline.storage.object_file import ObjectFile

# The footer of a Parquet file lies at its end: one request brings it, whatever the reader asks for first.
_TAIL_BYTES = 64 * 2**10


class RangedFile(ObjectFile):
    """One version of an object, read by ranges."""

    def __init__(self, bucket: Bucket, key: str, info: ObjectInfo) -> None:
        """Open a version of an object.

        Args:
            bucket: Its bucket.
            key: Its key.
            info: Its size and version.
        """
        super().__init__(bucket, key, info)
        self._tail = b""

    def readinto(self, buffer: Any) -> int:
        """Read bytes into a buffer, and return how many."""
        view = memoryview(buffer).cast("B")
        size = self._readable_size(len(view))
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
