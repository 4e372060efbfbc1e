"""numpy's own files: one array (`.npy`), or several by name (`.npz`). Nothing is unpickled."""

from __future__ import annotations

import io
import lzma
import struct
import tokenize
import warnings
import zipfile
import zlib

import numpy as np

from upvl_cli.datasets.shared.point_files.scan import MOST_BYTES, ScanPoints, column_names, scan_points
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

NPY_START = b"\x93NUMPY"
NPZ_START = b"PK\x03\x04"
_MOST_COLUMNS = 16
_PLACES = ("xyz", "points", "point_cloud", "pointcloud", "cloud", "pc", "pts", "scan", "data", "arr_0")
_HEADER_ERRORS = (
    ValueError, SyntaxError, TypeError, KeyError, IndexError, AttributeError, RecursionError, MemoryError,
    OverflowError, EOFError, tokenize.TokenError, struct.error,
)  # fmt: skip
_ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, OSError, ValueError, EOFError,
    KeyError, OverflowError, IndexError, struct.error,
)  # fmt: skip


def read_npy(content: bytes, where: str) -> ScanPoints:
    """Return the sweep of a `.npy`: an (n, 3 to 16) table, the same on its side, or rows with named fields.

    Args:
        content: The bytes of the file.
        where: The file, for messages.

    Raises:
        BadInput: The header is damaged, or the array is no table of points.
    """
    columns = _columns(_array(content, where), where)
    return scan_points(columns, f"npy with {', '.join(columns)}"[:200], where)


def read_npz(content: bytes, where: str) -> ScanPoints:
    """Return the sweep of a `.npz`: an array such as `xyz` or `points`, or x, y and z apart.

    Further arrays of the same length give intensity, ring and time under their names.

    Args:
        content: The bytes of the file.
        where: The file, for messages.

    Raises:
        BadInput: The archive is damaged, or has no such array.
    """
    arrays = _members(content, where)
    by_name = {name.lower(): values for name, values in arrays.items()}
    name = next((name for name in _PLACES if name in by_name), None)
    if name is None and len(by_name) == 1:
        name = next(iter(by_name))
    columns = _columns(by_name.pop(name), f"{where}, array {name[:40]!r}") if name else {}
    length = len(next(iter(columns.values()))) if columns else None
    for other, values in by_name.items():
        values = values.reshape(-1) if values.ndim == 2 and 1 in values.shape else values
        if values.ndim == 1 and values.dtype.kind in "fiub" and length in (None, len(values)):
            length = len(values)
            columns[other] = values
    return scan_points(columns, f"npz with {', '.join(arrays)}"[:200], where)


def _members(content: bytes, where: str) -> dict[str, Array]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            infos = [info for info in archive.infolist() if info.filename.endswith(".npy")]
            if sum(info.file_size for info in infos) > MOST_BYTES:
                raise BadInput(
                    f"{where} would unpack to more than {MOST_BYTES >> 20} MiB, which no sweep has"
                )
            parts = {info.filename[:-4]: _unpacked(archive, info) for info in infos}
    except _ZIP_ERRORS as error:
        raise BadInput(f"{where} is a damaged npz ({str(error)[:80]}); copy it again, or remove it") from None
    return {name: _array(part, f"{where}, array {name[:40]!r}") for name, part in parts.items()}


def _unpacked(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    with archive.open(info) as file:
        return file.read(min(info.file_size, MOST_BYTES))


def _array(content: bytes, where: str) -> Array:
    """Return the array without copying it; the header is believed only as far as the bytes go."""
    file = io.BytesIO(content)
    read_header = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
    try:
        with warnings.catch_warnings(action="ignore"):
            major, _ = np.lib.format.read_magic(file)
            shape, is_fortran, dtype = read_header[major](file)
    except _HEADER_ERRORS:
        raise BadInput(
            f"{where}: its npy header is damaged; copy it again, or remove it to skip it"
        ) from None
    if dtype.hasobject:
        raise BadInput(
            f"{where} holds Python objects, which are never read; save plain numbers: np.save(f, xyzi)"
        )
    total, start = 1, file.tell()
    for length in shape:
        total *= length
    if not dtype.itemsize or any(not 0 <= length <= len(content) for length in shape):
        raise BadInput(
            f"{where}: its npy header says shape {str(shape)[:80]}, expected an (n, 3 or more) table"
        )
    if total * dtype.itemsize > len(content) - start:
        raise BadInput(
            f"{where}: its npy header announces {total * dtype.itemsize} bytes, and {len(content) - start} follow: "
            "it is cut off; copy it again, or remove it to skip it"
        )
    values = np.frombuffer(content, dtype, total, start)
    return values.reshape(shape, order="F" if is_fortran else "C")


def _columns(values: Array, where: str) -> dict[str, Array]:
    """Return the columns of a table by name."""
    if values.dtype.names:
        fields = values.reshape(-1)
        found: dict[str, Array] = {}
        for name in values.dtype.names:
            column = fields[name]
            if column.dtype.kind in "fiub" and column.ndim == 1:
                found[name] = column
            elif column.dtype.kind in "fiu" and column.shape[1:] == (3,) and name.lower() in _PLACES:
                found |= dict(zip("xyz", column.T, strict=True))
        return found
    if values.dtype.kind in "fiu" and values.ndim >= 2:
        width = values.shape[-1]
        if values.ndim == 2 and not 3 <= width <= _MOST_COLUMNS and 3 <= values.shape[0] <= _MOST_COLUMNS:
            values, width = values.T, values.shape[0]
        if 3 <= width <= _MOST_COLUMNS:
            rows = values.reshape(-1, width)
            names = column_names(width, [rows[:, place] for place in range(4, width)])
            return {name: rows[:, place] for place, name in enumerate(names)}
    raise BadInput(
        f"{where} holds {values.dtype} of shape {values.shape}, expected an (n, 3 to {_MOST_COLUMNS}) table of "
        "numbers: x, y, z, intensity, ..."
    )
