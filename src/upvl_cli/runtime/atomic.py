"""Files that appear whole or not at all, with one writer at a time."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Protocol, cast

from upvl_cli.errors import UpvlError, one_line

# What file systems without locks answer: some network shares, containers and phones.
_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}
_warned_folders: set[Path] = set()


class NotNeeded(Exception):  # noqa: N818
    """Raised inside `atomic_file` to leave it without a file and without an error."""


class WrittenWhole(Protocol):
    """A path that is not of this machine, and knows itself how it is written whole."""

    def write_whole(self, *, one_writer: bool) -> contextlib.AbstractContextManager[IO[bytes]]:
        """Open a local file that becomes the object when the block ends well."""


@contextlib.contextmanager
def atomic_file(path: Path, *, one_writer: bool = False) -> Iterator[IO[bytes]]:
    """Open a binary file that appears at `path` only when the block ends well.

    Args:
        path: Where the file goes; the path of an object is written as that object.
        one_writer: Whether, in an object store, a second process that wants the same path waits until the first is
            done; on a file system it always does.

    Raises:
        UpvlError: The folder cannot be written or the disk is full.
    """
    elsewhere = _elsewhere(path)
    if elsewhere is not None:
        with contextlib.suppress(NotNeeded), elsewhere.write_whole(one_writer=one_writer) as file:
            yield file
        return
    part = _part_of(path)
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
    except NotNeeded:
        return
    except OSError as error:
        raise UpvlError(
            f"cannot write {path}: {error.strerror or one_line(error)}; make room or make the folder writable, "
            "or choose another with --out"
        ) from error


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give the path of a file beside `path` that moves to `path` only when the block ends well.

    For a library that opens its files itself; it must write into the file that is there, and not replace it.

    Raises:
        UpvlError: The folder cannot be written or the disk is full.
    """
    with atomic_file(path) as file:
        yield _part_of(path) if _elsewhere(path) is None else Path(file.name)


def write_if_changed(path: Path, text: str) -> bool:
    """Write a small text file, atomically, only where it would differ; return whether it was written."""
    content = text.encode("utf-8", "surrogateescape")
    with contextlib.suppress(OSError):
        if path.read_bytes() == content:
            return False
    with atomic_file(path) as file:
        file.write(content)
    return True


def _elsewhere(path: Path) -> WrittenWhole | None:
    return cast(WrittenWhole, path) if hasattr(path, "write_whole") else None


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


@contextlib.contextmanager
def _locked(part: Path) -> Iterator[IO[bytes]]:
    """Open the part file, emptied and locked against other processes; a killed process holds no lock."""
    while True:
        if part.is_symlink() or (part.exists() and not _ours(part.stat())):
            part.unlink()  # a link or a pipe: writing would end up elsewhere
        with os.fdopen(os.open(part, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+b") as file:
            _lock(file, fcntl.LOCK_EX, part)
            if _is_at(file, part):
                file.truncate(0)
                yield file
                return
        # the one that held it has moved it into place


@contextlib.contextmanager
def _removed_on_failure(part: Path) -> Iterator[None]:
    """Remove the part file after an error or a Ctrl-C at any moment, unless another process holds it."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError), part.open("r+b") as file:
            _lock(file, fcntl.LOCK_EX | fcntl.LOCK_NB, part)
            if _is_at(file, part):
                part.unlink()
        raise


def _lock(file: IO[bytes], operation: int, path: Path) -> None:
    """Lock a file against other processes; where its file system has no locks, warn once a folder and go on."""
    try:
        fcntl.flock(file, operation)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        if path.parent not in _warned_folders:
            _warned_folders.add(path.parent)
            sys.stderr.write(
                f"upvl: warning: the file system of {path.parent} has no locks ({error.strerror}); run only one "
                "command at a time on it\n"
            )


def _is_at(file: IO[bytes], path: Path) -> bool:
    return path.exists() and path.stat().st_ino == os.fstat(file.fileno()).st_ino


def _ours(found: os.stat_result) -> bool:
    return stat.S_ISREG(found.st_mode) and found.st_nlink == 1
