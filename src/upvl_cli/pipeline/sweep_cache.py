"""Copies of sweeps on the local disk, for a stage that reads each of them many times where making one takes long.

A built-in drive computes its sweeps, some seconds each, and those of an object store come over a network. A sweep is
copied when it is read first, by each machine those that it reads. The copies are bounded in bytes, what was not read
for longest goes first, and their folder can be removed at any time.
"""

from __future__ import annotations

import threading
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from upvl_cli.pipeline.storage.file_cache import FileCache, file_cache
from upvl_cli.pipeline.storage.remote_path import is_remote
from upvl_cli.types import Array, Points

if TYPE_CHECKING:
    from upvl_cli.types import Drive

_MOST_BYTES = 20 * 10**9  # some thousand sweeps of 100 000 points


def cache_beside(folder: Path) -> FileCache:
    """Return the cache of sweeps of a stage: in its folder, or among the copies of objects where that is remote."""
    return file_cache() if is_remote(folder) else FileCache(folder / "sweeps", _MOST_BYTES)


class CachedSweeps:
    """The sweeps of one drive (a `Sweeps`), each copied when it is read first."""

    def __init__(self, cache: FileCache, segment: str, stamp: str, open_drive: Callable[[], Drive]) -> None:
        """Name the drive, which is opened when something is read that no copy has.

        Args:
            cache: The copies.
            segment: Name of the drive.
            stamp: Changes whenever the drive's content does: what an older drive had is not read.
            open_drive: Opens the drive.
        """
        self._cache, self._segment, self._stamp, self._open = cache, segment, stamp, open_drive
        self._drive: Drive | None = None
        self._lock = threading.Lock()

    @cached_property
    def ground_z_m(self) -> float:
        """Height of the road below the car in ego axes, roughly."""
        make = lambda: {"ground_z_m": np.array(self._opened().ground_z_m)}  # noqa: E731
        return float(self._arrays("ground", make)["ground_z_m"])

    def read(self, frame: int) -> Points:
        """Return the sweep of a frame."""

        def make() -> dict[str, Array]:
            points = self._opened().points(frame)
            return {spec.name: getattr(points, spec.name) for spec in fields(points)}

        return Points(**self._arrays(str(frame), make))

    def _opened(self) -> Drive:
        with self._lock:  # frames are read by several threads
            if self._drive is None:
                self._drive = self._open()
            return self._drive

    def _arrays(self, name: str, make: Callable[[], Mapping[str, Array]]) -> Mapping[str, Array]:
        """Return arrays from their copy, which is made where there is none or a damaged one."""
        address = f"sweeps/{self._segment}/{name}.npz"
        path = self._cache.held(address, self._stamp)
        if path is not None:
            try:
                with np.load(path, allow_pickle=False) as found:
                    return dict(found)
            except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
                pass  # removed meanwhile, or damaged
        arrays = make()

        def write(file: IO[bytes]) -> str:
            np.savez(file, allow_pickle=False, **arrays)
            return self._stamp

        self._cache.add(address, write)
        return arrays
