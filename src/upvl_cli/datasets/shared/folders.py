"""Folders and files of drives, on this machine or in an object store."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import IO, Protocol, cast


class RemoteDrivePath(Protocol):
    """What the path of a drive in an object store knows beside what a `Path` does."""

    def entries(self) -> list[tuple[str, bool]]:
        """Return the names of what is directly below, sorted, each with whether it is a folder."""

    def look_among(self, names: Collection[str]) -> None:
        """Ask the store for some objects of this folder at once."""

    def list_at_once(self, names: Collection[str]) -> None:
        """List several folders of this one at once."""

    def local_folder(self) -> Path:
        """Return a local folder with copies of all objects below this one."""


def absolute(path: Path) -> Path:
    """Return a path that has a name, also for the folder `.`; links stay as they are."""
    return path if _remote(path) is not None else Path(os.path.abspath(path))


def entries(folder: Path) -> list[tuple[str, bool]]:
    """Return the names of what a folder holds, sorted, each with whether it is a folder.

    Raises:
        OSError: There is no such folder, or it may not be listed.
    """
    remote = _remote(folder)
    if remote is None:
        with os.scandir(folder) as found:
            return sorted((entry.name, entry.is_dir()) for entry in found)
    names = remote.entries()
    if not names:  # an object store has no empty folders
        raise FileNotFoundError(2, "no such folder", str(folder))
    return names


def subfolders(folder: Path) -> list[str]:
    """Return the names of the folders in a folder, sorted; raises `OSError` where it cannot be listed."""
    return [name for name, is_folder in entries(folder) if is_folder]


def list_at_once(folder: Path, names: Collection[str]) -> None:
    """Prepare to list several folders of a folder: those of an object store are listed together now."""
    remote = _remote(folder)
    if remote is not None:
        remote.list_at_once(names)


def is_link(path: Path) -> bool:
    """Return whether a path is a link; object stores have none."""
    return _remote(path) is None and os.path.islink(path)


def present_files(paths: Collection[Path]) -> set[Path]:
    """Return those of many files that are there; none is opened."""
    by_folder: dict[Path, set[str]] = {}
    for path in paths:
        if _remote(path) is not None:
            by_folder.setdefault(path.parent, set()).add(path.name)
    for folder, names in by_folder.items():
        cast(RemoteDrivePath, folder).look_among(names)
    return {path for path in paths if (os.path.isfile(path) if _remote(path) is None else path.is_file())}


def local_folder(folder: Path) -> Path:
    """Return the folder, or a copy on this machine where it lies in an object store.

    Raises:
        OSError: There is no such folder.
    """
    remote = _remote(folder)
    return folder if remote is None else remote.local_folder()


def open_parts(path: Path) -> Path | IO[bytes]:
    """Return what Arrow opens: a file of this machine by its path, an object as a file of which parts are fetched.

    Raises:
        OSError: There is no such file.
    """
    return path if _remote(path) is None else path.open("rb")


def read_at(file: IO[bytes], position: int, size: int) -> bytes:
    """Return bytes of a file that is opened without a buffer; fewer where it ends before."""
    file.seek(position)
    content = file.read(size)
    while 0 < len(content) < size:
        more = file.read(size - len(content))
        if not more:
            break
        content += more
    return content


def _remote(path: Path) -> RemoteDrivePath | None:
    return cast(RemoteDrivePath, path) if hasattr(path, "look_among") else None
