"""Raw rows of floats, as `.bin` files are: how wide a row is, and in which type and byte order, stands nowhere.

Whether a file has the rows that are expected is read off the numbers. A value resembles the one below it in its
column, and not those beside it: of all distances between two values of the dump, the mean difference is least at
the width of a row. On sweeps of KITTI, nuScenes and View-of-Delft it is two to seventy times less there than at any
other distance, and still a quarter less with the rows shuffled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from upvl_cli.datasets.shared.point_files.scan import ScanPoints, column_names, scan_points
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

_TYPES = {"<f4": "float32", ">f4": "big-endian float32", "<f8": "float64", ">f8": "big-endian float64"}
_WIDTHS = range(3, 9)
_BLOCK = 3600  # words; a multiple of no width matters, only that all widths fit many times
_BLOCKS = 8  # spread over the file: a thirtieth of a sweep says enough
_LEAST_WORDS = 240
# Of a number of the wrong type or byte order the exponent is nearly random; of sweeps it is not.
_LEAST_VALUE, _MOST_VALUE = 1e-6, 1e10
_LEAST_SHARE = 0.97
_CLEAR = 0.8  # the least mean difference over the next: 0.02 to 0.5 on sweeps, 0.76 with rows shuffled
_SIMILAR = 1.25


@dataclass(frozen=True)
class RowLayout:
    """How a dump of floats is made up.

    Attributes:
        dtype: numpy's name of the type and byte order, for example "<f4".
        columns: How many numbers a row has.
    """

    dtype: str
    columns: int

    @cached_property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self.columns * np.dtype(self.dtype).itemsize

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.columns} columns of {_TYPES[self.dtype]}"


def recognise_rows(content: bytes) -> RowLayout | None:
    """Return the layout that the numbers show, or None where they show none clearly.

    Args:
        content: The bytes of the file.
    """
    for dtype in _TYPES:
        words = _sample(content, dtype)
        if words is not None and _is_plausible(words):
            columns = _width(words)
            return RowLayout(dtype, columns) if columns else None
    return None


def read_bin(content: bytes, columns: int | None, where: str) -> ScanPoints:
    """Return the sweep of a dump of floats.

    Args:
        content: The bytes of the file.
        columns: Little-endian float32 in rows of so many numbers are expected; None for whatever is recognised.
        where: The file, for messages.

    Raises:
        BadInput: It is empty, cut off, or of another layout than expected.
    """
    if not content:
        raise BadInput(f"{where} is empty; copy it again, or remove it to skip it")
    if not any(content):
        raise BadInput(
            f"{where} holds only zeros ({len(content)} bytes); copy it again, or remove it to skip it"
        )
    layout = _expected(content, columns, where) if columns else _found(content, where)
    rows = np.frombuffer(content, dtype=layout.dtype).reshape(-1, layout.columns)
    names = ("x", "y", "z", "intensity", "ring")[:columns] if columns and columns <= 5 else None
    if names is None:
        names = column_names(layout.columns, [rows[:, place] for place in range(4, layout.columns)])
    described = f"{_TYPES[layout.dtype]} {', '.join(names)}"
    return scan_points({name: rows[:, place] for place, name in enumerate(names)}, described, where)


def _expected(content: bytes, columns: int, where: str) -> RowLayout:
    """Return the expected layout; raises `BadInput` where the file clearly has another."""
    expected = RowLayout("<f4", columns)
    found = recognise_rows(content)
    if found and found != expected and not _fits(content, columns):
        raise BadInput(
            f"{where} holds {found} ({len(content)} bytes), expected {expected}: it comes from another data set or "
            "tool; read it with the adapter of its data set, or make a drive of it with: upvl import"
        )
    if len(content) % expected.row_bytes:
        raise BadInput(
            f"{where} has {len(content)} bytes, expected a multiple of {expected.row_bytes} above 0 ({expected}): "
            "it is cut off; copy it again, or remove it to skip it"
        )
    return expected


def _found(content: bytes, where: str) -> RowLayout:
    found = recognise_rows(content)
    if found is None:
        fitting = [width for width in (4, 5) if len(content) % (4 * width) == 0]
        words = _sample(content, "<f4", least=0)
        if len(fitting) == 1 and words is not None and _is_plausible(words):
            return RowLayout("<f4", fitting[0])
        raise BadInput(
            f"{where} ({len(content)} bytes) is not recognised as points; expected PCD, PLY, npy, npz, or rows of "
            f"{_WIDTHS[0]} to {_WIDTHS[-1]} float32 or float64: x, y, z, intensity, ..."
        )
    if len(content) % found.row_bytes:
        raise BadInput(
            f"{where} has {len(content)} bytes and holds {found}, but rows of {found.row_bytes} bytes do not fill "
            "it: it is cut off; copy it again, or remove it to skip it"
        )
    return found


def _sample(content: bytes, dtype: str, least: int = _LEAST_WORDS) -> Array | None:
    """Return (blocks, words) of the file, read as this type; None where there are too few."""
    total = len(content) // np.dtype(dtype).itemsize
    if total <= least:
        return None
    words = np.frombuffer(content, dtype=dtype, count=total)
    size = min(total, _BLOCK)
    starts = np.unique(np.linspace(0, total - size, _BLOCKS).astype(np.int64))
    with np.errstate(invalid="ignore"):  # numbers of the wrong type may be anything
        return np.stack([words[start : start + size] for start in starts]).astype(np.float64)


def _is_plausible(words: Array) -> bool:
    """Whether the numbers are such as places, intensities and times are; NaN is a ray without return."""
    size = np.abs(words)
    is_number = (size == 0) | ((size >= _LEAST_VALUE) & (size <= _MOST_VALUE))
    return bool((is_number | np.isnan(words)).mean() >= _LEAST_SHARE and is_number.mean() > 0.05)


def _differences(words: Array) -> dict[int, float]:
    """Return the mean difference between numbers that stand `width` apart, by width."""
    scale = np.sign(words) * np.log1p(10 * np.abs(words))  # so that one large column does not decide alone
    found = {}
    for width in _WIDTHS:
        between = np.abs(scale[:, width:] - scale[:, :-width])
        between = between[np.isfinite(between)]
        found[width] = float(between.mean()) if len(between) else np.inf
    return found


def _width(words: Array) -> int | None:
    """Return how many columns the numbers have; None where that is not clear."""
    found = _differences(words)
    least = min(found.values())
    width = next(width for width, value in found.items() if value <= 1.1 * least)  # not a multiple of it
    others = [value for other, value in found.items() if other % width]
    return width if np.isfinite(least) and found[width] < _CLEAR * min(others) else None


def _fits(content: bytes, columns: int) -> bool:
    """Whether rows of so many float32 fit the numbers about as well as any others."""
    words = _sample(content, "<f4")
    if words is None or not _is_plausible(words):
        return False
    found = _differences(words)
    return found[columns] <= _SIMILAR * min(found.values())
