"""Arrow tables from Parquet and Feather files: columns cast to what they must be, or one clear error."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pyarrow.feather
import pyarrow.parquet as pq

from upvl_cli.datasets.shared.folders import open_parts
from upvl_cli.errors import BadInput, one_line
from upvl_cli.types import Array

_MAX_FOOTER_BYTES = 2**28  # a damaged footer must not make Arrow allocate more
_SHOWN = 160  # characters of Arrow's own message


@contextmanager
def arrow_errors(where: object) -> Iterator[None]:
    """Raise what Arrow finds wrong with a file as `BadInput`."""
    try:
        yield
    except BadInput:
        raise
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        system = getattr(error, "strerror", None)
        reason = system or one_line(error)[:_SHOWN]
        raise BadInput(f"{where} cannot be read ({reason}); write or copy it again") from None


def open_parquet(path: Path, buffer_bytes: int = 0) -> pq.ParquetFile:
    """Return an opened Parquet file.

    Args:
        path: The file.
        buffer_bytes: Read a column in buffers of this size; 0 reads that of a row group at once.

    Raises:
        BadInput: It is none.
    """
    with arrow_errors(path):
        return pq.ParquetFile(
            open_parts(path),
            thrift_string_size_limit=_MAX_FOOTER_BYTES,
            thrift_container_size_limit=_MAX_FOOTER_BYTES,
            pre_buffer=False,
            buffer_size=buffer_bytes,
        )


def read_parquet(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> pa.Table:
    """Return columns of a Parquet file.

    Args:
        path: The file.
        columns: Names of columns that it must have.
        optional: Names of those that it can have.

    Raises:
        BadInput: It cannot be read, or lacks a column.
    """
    file = open_parquet(path)
    names = file.schema_arrow.names
    check_columns(names, columns, path)
    with arrow_errors(path), file:
        return file.read(columns=[*columns, *(name for name in optional if name in names)])


def read_feather(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> pa.Table:
    """Return columns of a Feather file; see `read_parquet`."""
    with arrow_errors(path), pa.OSFile(os.fspath(path)) as source:
        reader = pa.ipc.open_file(source)
        names = reader.schema.names
        check_columns(names, columns, path)
        wanted = [*columns, *(name for name in optional if name in names)]
        table = reader.read_all()
        table.validate(full=True)
        return table.select(wanted)


def check_columns(found: Sequence[str], columns: Sequence[str], where: object) -> None:
    """Raise `BadInput` where a table lacks columns: all of those that it lacks in one line."""
    missing = [name for name in columns if name not in found]
    if missing:
        raise BadInput(
            f"{where} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}; "
            f"it has {', '.join(found)[:300] or 'none'}"
        )


def values(table: pa.Table, name: str, dtype: str, where: object) -> Array:
    """Return a column of numbers without gaps.

    Args:
        table: The table.
        name: The column.
        dtype: The type to cast to, for example `float64`; a number that does not fit is an error.
        where: The file, for the message.

    Raises:
        BadInput: There is a null, or a value that is no such number.
    """
    column = table[name]
    if column.null_count:
        raise BadInput(
            f"{where}: the column {name} has {column.null_count} empty cells, expected {dtype} in each"
        )
    return _cast(column, name, dtype, where)


def integers(table: pa.Table, name: str, where: object) -> Array:
    """Return a column of whole numbers as int64; raises `BadInput` for another type, an empty cell, a large number."""
    kind = table[name].type
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    if not (pa.types.is_integer(kind) or pa.types.is_null(kind)):
        raise BadInput(
            f"{where}: the column {name} is of type {table[name].type}, expected whole numbers (int64)"
        )
    return values(table, name, "int64", where)


def floats_or_nan(table: pa.Table, name: str, where: object) -> Array:
    """Return a column as float64, NaN in its empty cells."""
    return _cast(table[name], name, "float64", where)


def _cast(column: pa.ChunkedArray, name: str, dtype: str, where: object) -> Array:
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    is_number = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind)
    if not is_number and not (pa.types.is_decimal(kind) or pa.types.is_boolean(kind)):
        raise BadInput(f"{where}: the column {name} is of type {column.type}, expected {dtype}")
    with arrow_errors(f"{where}, column {name}"):
        cast = column.cast(pa.from_numpy_dtype(np.dtype(dtype)))
        return np.array(cast.to_numpy(zero_copy_only=False), dtype=dtype, copy=False)


def texts(table: pa.Table, name: str, where: object) -> list[str]:
    """Return a column of text without gaps; whole numbers become text.

    Raises:
        BadInput: There is a null, or something that is no text.
    """
    column = table[name]
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if column.null_count:
        raise BadInput(
            f"{where}: the column {name} has {column.null_count} empty cells, expected text in each"
        )
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_integer(kind)):
        raise BadInput(f"{where}: the column {name} is of type {column.type}, expected string")
    with arrow_errors(f"{where}, column {name}"):
        return [str(text) for text in column.to_pylist()]


def is_list(kind: pa.DataType) -> bool:
    """Return whether a column holds lists of numbers."""
    listed = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    return bool(listed and (pa.types.is_integer(kind.value_type) or pa.types.is_floating(kind.value_type)))


def list_cell(column: pa.ChunkedArray, row: int, dtype: str, where: object) -> Array:
    """Return the numbers of one cell of a column of lists.

    Args:
        column: The column.
        row: Number of the row.
        dtype: The type to cast to.
        where: The file and the column, for the message.

    Raises:
        BadInput: The cell is empty (null), has nulls inside, or holds no such numbers.
    """
    if not is_list(column.type):
        raise BadInput(f"{where} is of type {column.type}, expected lists of {dtype}")
    with arrow_errors(f"{where}, row {row}"):
        cell = column[row]
        if not cell.is_valid:
            raise BadInput(f"{where}, row {row} is empty (null), expected a list of {dtype}")
        numbers = cell.values
        if numbers.null_count:
            raise BadInput(
                f"{where}, row {row} has {numbers.null_count} empty numbers, expected {dtype} in each"
            )
        return np.asarray(numbers.cast(pa.from_numpy_dtype(np.dtype(dtype))).to_numpy(zero_copy_only=False))


def matrices(table: pa.Table, name: str, count: int, where: object) -> Array | None:
    """Return (n, count) float64 of a column of lists of equal length; None where all cells are empty (null).

    Raises:
        BadInput: Some cells are empty and others not, or a cell has another number of values.
    """
    column = table[name]
    if pa.types.is_null(column.type) or (len(column) and column.null_count == len(column)):
        return None
    if not is_list(column.type):
        raise BadInput(
            f"{where}: the column {name} is of type {column.type}, expected lists of {count} numbers"
        )
    if column.null_count:
        raise BadInput(
            f"{where}: the column {name} has {column.null_count} empty cells of {len(column)}, "
            "expected all rows or none"
        )
    with arrow_errors(f"{where}, column {name}"):
        lengths = pa.compute.list_value_length(column).to_numpy(zero_copy_only=False)
        wrong = np.flatnonzero(lengths != count)
        if len(wrong):
            raise BadInput(
                f"{where}: {name} of row {wrong[0]} has {lengths[wrong[0]]} numbers, expected {count}"
            )
        flat = pa.compute.list_flatten(column)
        if flat.null_count:
            raise BadInput(
                f"{where}: the column {name} has empty numbers inside its lists, expected {count} in each"
            )
        return np.asarray(flat.cast(pa.float64()).to_numpy(zero_copy_only=False)).reshape(-1, count)


def metadata_text(metadata: Mapping[bytes, bytes] | None, key: str, where: object) -> str | None:
    """Return a value of a schema's key-value metadata; None where it has none of that key."""
    content: Any = (metadata or {}).get(key.encode())
    if content is None:
        return None
    try:
        return str(content.decode())
    except UnicodeDecodeError:
        raise BadInput(f"{where}: the metadata {key} is not text; write the file again") from None
