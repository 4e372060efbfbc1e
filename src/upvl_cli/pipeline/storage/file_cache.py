"""Copies of objects on the local disk, bounded in bytes; what was not used for longest goes first.

A copy belongs to one version of an object, so none is ever out of date. The folder can be deleted while nothing runs.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import IO

from upvl_cli.errors import BadSetting, StorageError

FOLDER_VARIABLE, SIZE_VARIABLE = "UPVL_CACHE", "UPVL_CACHE_GB"
_DEFAULT_GB = 20.0
_GRACE_S = 60.0  # one who was just given a name may not have opened the file yet
_ABANDONED_S = 86400.0  # a part file of a process that was killed


class FileCache:
    """A folder of copies of objects."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        """Name the folder; it is made when the first copy is.

        Args:
            folder: Folder of the copies.
            max_bytes: Largest size of all copies; the one that is in use can be larger.
        """
        self._folder, self._max_bytes = folder, max_bytes
        self._since_count = max_bytes  # bytes that came since the folder was last measured: at first it is

    @property
    def parts(self) -> Path:
        """Folder of files that are being written, and of what waits on disk."""
        return self._folder / "parts"

    def held(self, address: str, version: str) -> Path | None:
        """Return the copy of a version of an object; None where there is none."""
        path = self._path(address, version)
        try:
            os.utime(path)  # used last now
        except OSError:
            return None
        return path

    def add(self, address: str, write: Callable[[IO[bytes]], str]) -> Path:
        """Make a copy and return its path.

        Args:
            address: Address of the object.
            write: Writes its content and returns its version.
        """
        with self.part(Path(address).name) as file:
            version = write(file)
            file.flush()
            return self.adopt(Path(file.name), address, version)

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[IO[bytes]]:
        """Open a file that is deleted when the block ends, unless it was adopted as a copy."""
        folder = self.parts
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            file = tempfile.NamedTemporaryFile("w+b", dir=folder, suffix=f"-{name}"[-80:], delete=False)  # noqa: SIM115
        except OSError as error:
            raise StorageError(
                f"{folder} cannot be written: {error.strerror}; name another folder in {FOLDER_VARIABLE}"
            ) from None
        try:
            with file:
                yield file
        finally:
            with contextlib.suppress(OSError):
                os.unlink(file.name)

    def adopt(self, part: Path, address: str, version: str) -> Path:
        """Keep a part file as the copy of a version of an object, and return its path."""
        path = self._path(address, version)
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        size = part.stat().st_size
        part.replace(path)
        self._since_count += size
        if self._since_count > self._max_bytes // 20:
            self._since_count = 0
            self._shrink(keep=path)
        return path

    def folder(self, address: str, version: str, write: Callable[[Path], None]) -> Path:
        """Return a folder of copies, which is made where it is not there yet and deleted as a whole.

        Args:
            address: Address of the folder.
            version: Changes whenever the content does.
            write: Writes the content into an empty folder.
        """
        path = self._path(address, version, "folders")
        with contextlib.suppress(OSError):
            os.utime(path)  # used last now
            return path
        with self.part("folder") as file:  # says whether the cache can be written
            part = Path(f"{file.name}.d")
            try:
                part.mkdir(mode=0o700)
                write(part)
                path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
                with contextlib.suppress(OSError):  # another process was faster
                    part.replace(path)
            finally:
                shutil.rmtree(part, ignore_errors=True)
        self._shrink(keep=path)
        return path

    def _path(self, address: str, version: str, kind: str = "objects") -> Path:
        digest = hashlib.sha256(f"{address}\n{version}".encode()).hexdigest()[:32]
        # The name stays: libraries tell a format by it.
        return self._folder / kind / digest[:2] / digest / Path(address).name

    def _shrink(self, keep: Path) -> None:
        """Delete what was used before all else until the rest fits."""
        now = time.time()
        copies = [*self._copies(now), *self._folders()]
        total = sum(size for _, size, _ in copies)
        for used, size, path in sorted(copies):
            if total <= self._max_bytes or now - used < _GRACE_S:
                return
            if path != str(keep):
                with contextlib.suppress(OSError):
                    if os.path.isdir(path):
                        shutil.rmtree(path)
                    else:
                        os.unlink(path)
                    os.rmdir(os.path.dirname(path))
                total -= size

    def _copies(self, now: float) -> Iterator[tuple[float, int, str]]:
        """Yield time of use, bytes and path of each copy, and delete parts that were left behind."""
        for kind in ("parts", "objects"):
            for folder, _, names in os.walk(self._folder / kind):
                for name in names:
                    path = os.path.join(folder, name)
                    with contextlib.suppress(OSError):
                        found = os.stat(path)
                        if kind == "objects":
                            yield found.st_mtime, found.st_size, path
                        elif now - found.st_mtime > _ABANDONED_S:
                            os.unlink(path)

    def _folders(self) -> Iterator[tuple[float, int, str]]:
        """Yield time of use, bytes and path of each folder of copies."""
        for path in (self._folder / "folders").glob("*/*/*"):
            with contextlib.suppress(OSError):
                files = [file.stat() for file in path.rglob("*")]
                yield path.stat().st_mtime, sum(file.st_size for file in files), str(path)


@cache
def file_cache() -> FileCache:
    """Return the cache of this process: in `UPVL_CACHE`, of at most `UPVL_CACHE_GB` gigabytes.

    Raises:
        BadSetting: The size is no number from 0 on.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    text = os.environ.get(SIZE_VARIABLE)
    try:
        size_gb = _DEFAULT_GB if text is None else float(text)
    except ValueError:
        size_gb = -1.0
    if not 0 <= size_gb <= 1e6:
        raise BadSetting(f"{SIZE_VARIABLE} is {text!r}, expected gigabytes, a number from 0 to 1000000")
    folder = os.environ.get(FOLDER_VARIABLE)
    return FileCache(Path(folder).expanduser() if folder else base / "upvl", int(size_gb * 1e9))
