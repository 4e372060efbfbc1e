"""Arrays that wait on disk, where a drive's are too many for memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

_Array = npt.NDArray[Any]


class ArraySpill:
    """Arrays in a file without a name, which the system removes when the process ends; read once, in order."""

    def __init__(self, folder: Path) -> None:
        """Open the file.

        Args:
            folder: A folder with room; it is made if need be.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        self._total = 0

    def append(self, array: _Array) -> None:
        """Write an array behind the others."""
        np.save(self._file, array, allow_pickle=False)
        self._total += 1

    def __len__(self) -> int:
        return self._total

    def __iter__(self) -> Iterator[_Array]:
        self._file.seek(0)
        for _ in range(self._total):
            yield np.load(self._file, allow_pickle=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
