"""An object opened like a file: what ways of fetching its bytes have in common."""

from __future__ import annotations

import io
import os

from upvl_cli.pipeline.storage.bucket import Bucket, ObjectInfo


class ObjectFile(io.RawIOBase):
    """One version of an object and the place of the next byte; those that derive from it say how bytes are fetched."""

    def __init__(self, bucket: Bucket, key: str, info: ObjectInfo) -> None:
        """Open a version of an object.

        Args:
            bucket: Its bucket.
            key: Its key.
            info: Its size and version.
        """
        self._bucket, self._key, self._info = bucket, key, info
        self._position = 0

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

    def _readable_size(self, wanted: int) -> int:
        """Return how many of some bytes there are from the place on."""
        return max(min(wanted, self._info.size - self._position), 0)
