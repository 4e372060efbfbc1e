"""A large object opened like a file: the blocks of it that are read are fetched, and kept in the local cache."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import IO, Any

from upvl_cli.pipeline.storage.bucket import Bucket, ObjectInfo
from upvl_cli.pipeline.storage.file_cache import file_cache
from upvl_cli.pipeline.storage.object_file import ObjectFile
from upvl_cli.pipeline.storage.read_ahead import read_ahead

BLOCK_BYTES = 4 * 2**20


class BlockFile(ObjectFile):
    """One version of an object, read by blocks that later readers on this machine find on its disk."""

    def __init__(self, bucket: Bucket, key: str, info: ObjectInfo) -> None:
        """Open a version of an object.

        Args:
            bucket: Its bucket.
            key: Its key.
            info: Its size and version.
        """
        super().__init__(bucket, key, info)
        self._address = bucket.address(key)
        self._opened: tuple[int, IO[bytes]] | None = None

    def readinto(self, buffer: Any) -> int:
        """Read bytes into a buffer, as many as it holds where there are so many, and return how many."""
        view = memoryview(buffer).cast("B")
        size = self._readable_size(len(view))
        done = 0
        while done < size:
            number, within = divmod(self._position, BLOCK_BYTES)
            block = self._block(number)
            block.seek(within)
            count = block.readinto(view[done:size])  # type: ignore[attr-defined]
            if not count:
                raise OSError(0, "a block of the local cache is cut off", self._address)
            done += count
            self._position += count
        return done

    def close(self) -> None:
        """Let go of the block that is open."""
        if self._opened is not None:
            self._opened[1].close()
            self._opened = None
        super().close()

    def _block(self, number: int) -> IO[bytes]:
        if self._opened is None or self._opened[0] != number:
            ahead = read_ahead()
            series = f"{self._address}\n{self._info.version}"
            for later in ahead.next_of(series, number):
                if later * BLOCK_BYTES < self._info.size and self._held(later) is None:
                    ahead.begin((series, str(later)), partial(self._fetch, later))
            path = self._held(number) or ahead.get((series, str(number)), partial(self._fetch, number))
            if self._opened is not None:
                self._opened[1].close()
            self._opened = number, path.open("rb", buffering=0)
        return self._opened[1]

    def _held(self, number: int) -> Path | None:
        return file_cache().held(self._address, self._version(number))

    def _version(self, number: int) -> str:
        return f"{self._info.version} block {number}"

    def _fetch(self, number: int) -> Path:
        held = self._held(number)
        if held is not None:
            return held

        def write(file: IO[bytes]) -> str:
            start = number * BLOCK_BYTES
            size = min(BLOCK_BYTES, self._info.size - start)
            file.write(self._bucket.read(self._key, start, size, self._info.version))
            return self._version(number)

        return file_cache().add(self._address, write)
