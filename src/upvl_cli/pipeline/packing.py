"""Between the rows of stages, which hold arrays, and the columns of Arrow tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from upvl_cli.pipeline.stage import Column, Row, columns_of
from upvl_cli.types import Array, Ragged

R = TypeVar("R", bound=Row)
_KEY = ("segment", "frame")


def schema_of(row: type[Row]) -> pa.Schema:
    """Return the Arrow schema that follows from a row's declaration; each field says meaning, unit and axes."""
    return pa.schema([field for name, spec in columns_of(row).items() for field in _fields(name, spec, row)])


def _fields(name: str, spec: Column, row: type[Row]) -> Iterator[pa.Field]:
    kind = _arrow_type(spec, in_frame_row=not row.per_box)
    metadata = {"meaning": spec.meaning, "unit": spec.unit, "axes": spec.axes, "per": spec.per or "frame"}
    metadata |= {"shape": " ".join(map(str, spec.shape)), "items": spec.type}
    known = {key: value for key, value in metadata.items() if value}
    for part in spec.table_names(name):
        yield pa.field(part, kind, nullable=False, metadata=known)


def _arrow_type(spec: Column, *, in_frame_row: bool) -> pa.DataType:
    """Return the type of one cell of the table."""
    item = pa.type_for_alias(spec.type)
    is_list = spec.is_array if in_frame_row else bool(spec.ragged or (spec.shape and not spec.split))
    if is_list and spec.shape and spec.type == "int8":
        # Parquet has no integers of one byte: a list would take four each, and their time.
        return pa.binary()
    return pa.list_(item) if is_list else item


def pack_frame_row(item: Row, schema: pa.Schema) -> pa.RecordBatch:
    """Return a batch of one row, with a list for each array."""
    lengths: dict[str, int] = {}
    arrays = []
    for name, spec in columns_of(type(item)).items():
        value, kind = getattr(item, name), schema.field(spec.table_names(name)[0]).type
        if not spec.is_array:
            arrays.append(pa.array([value], type=kind))
            continue
        flat = _checked(name, value, spec, lengths)
        arrays.append(_cells(flat, spec, kind, np.array([0, len(flat)])))
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def pack_box_row(item: Row, schema: pa.Schema) -> pa.RecordBatch:
    """Return a batch of one row a box."""
    lengths: dict[str, int] = {}
    declared = columns_of(type(item))
    packed: list[tuple[str, Column, Any]] = []
    for name, spec in declared.items():
        value = getattr(item, name)
        if spec.ragged:
            lengths.setdefault(spec.per, len(value.count))
            _checked(name, value.values, spec, {})
        elif spec.per:
            value = _checked(name, value, spec, lengths)
        packed.append((name, spec, value))
    boxes = lengths["box"]
    arrays = []
    for name, spec, value in packed:
        kind = schema.field(spec.table_names(name)[0]).type
        if not spec.per:
            arrays.append(pa.array([value] * boxes, type=kind))
        elif spec.ragged:
            width = int(np.prod(spec.shape, dtype=np.int64))
            ends = np.concatenate([[0], np.cumsum(value.count)]) * width
            arrays.append(_cells(np.ascontiguousarray(value.values).reshape(-1), spec, kind, ends))
        elif spec.split:
            arrays += [_cells(part, spec, kind) for part in value.reshape(boxes, len(spec.split)).T]
        elif spec.shape:
            width = len(value) // max(boxes, 1)
            arrays.append(_cells(value, spec, kind, np.arange(boxes + 1) * width))
        else:
            arrays.append(_cells(value, spec, kind))
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def _checked(name: str, value: Any, spec: Column, lengths: dict[str, int]) -> Array:
    """Return the flat values of an array, whose shape and numbers are as declared.

    A wrong one is a bug in the stage, not the user's fault: it keeps its traceback.
    """
    values = np.ascontiguousarray(value)
    expected = (lengths.setdefault(spec.per, len(values)), *spec.shape) if spec.per else spec.shape
    if values.shape != expected:
        raise ValueError(f"column {name} has shape {values.shape}, expected {expected}")
    flat = values.reshape(-1)
    if np.issubdtype(flat.dtype, np.floating) and not np.isfinite(flat).all():
        raise ValueError(f"column {name} holds NaN or infinite values")
    return flat


def _cells(flat: Array, spec: Column, kind: pa.DataType, ends: Array | None = None) -> pa.Array:
    """Return cells of the table: single values, or those between two ends as one list (or one string of bytes)."""
    if pa.types.is_string(kind):
        return pa.array(flat.tolist(), type=kind)
    if ends is None:
        return pa.array(flat.astype(np.dtype(kind.to_pandas_dtype()), copy=False), type=kind)
    if pa.types.is_binary(kind):
        values = flat.astype(spec.type, copy=False)
        return pa.array([values[a:b].tobytes() for a, b in zip(ends[:-1], ends[1:], strict=True)], type=kind)
    item = kind.value_type
    values = pa.array(flat.astype(np.dtype(item.to_pandas_dtype()), copy=False), type=item)
    return pa.ListArray.from_arrays(pa.array(ends, pa.int32()), values, type=kind)


def unpack_frame_row(row: type[R], columns: pa.Table) -> R:
    """Return the row of a frame from a table of one row."""
    return row(
        **{
            name: _of_frame(columns.column(spec.table_names(name)[0]), spec)
            for name, spec in columns_of(row).items()
        }
    )


def _of_frame(values: pa.ChunkedArray, spec: Column) -> Any:
    if not spec.is_array:
        return values[0].as_py()
    flat = _flat(values, spec)
    shape = (-1, *spec.shape) if spec.per else spec.shape
    return flat.reshape(shape) if flat.size or not spec.per else flat.reshape(0, *spec.shape)


def scalars_of(item: Row) -> dict[str, object]:
    """Return what a table of boxes would lose where the frame has no box: values of the frame, beside the key."""
    declared = columns_of(type(item)).items() if item.per_box else ()
    return {name: getattr(item, name) for name, spec in declared if not spec.per and name not in _KEY}


def unpack_box_row(
    row: type[R], columns: pa.Table, segment: str, frame: int, scalars: Mapping[str, object]
) -> R:
    """Return the row of a frame from the table of its boxes, which may be none.

    Args:
        row: The declared row.
        columns: The rows of the table.
        segment: Name of the drive.
        frame: Number of the frame.
        scalars: Values of the frame, as `scalars_of` gave them.
    """
    boxes = columns.num_rows
    declared = columns_of(row)
    # A row may declare fewer columns than the table has.
    known = {name: value for name, value in scalars.items() if name in declared}
    values: dict[str, Any] = {"segment": segment, "frame": frame, **known}
    for name, spec in declared.items():
        if spec.split:
            parts = [_flat(columns.column(part), spec) for part in spec.split]
            values[name] = np.column_stack(parts) if boxes else np.zeros((0, *spec.shape), parts[0].dtype)
        elif spec.ragged:
            cells, width = columns.column(spec.table_names(name)[0]), int(np.prod(spec.shape, dtype=np.int64))
            values[name] = Ragged(_flat(cells, spec).reshape(-1, *spec.shape), _lengths(cells, spec) // width)
        elif spec.per:
            values[name] = _flat(columns.column(spec.table_names(name)[0]), spec).reshape(boxes, *spec.shape)
    return row(**values)


def _lengths(cells: pa.ChunkedArray, spec: Column) -> Array:
    """Return how many values each cell holds."""
    found = [np.diff(np.asarray(chunk.offsets)) for chunk in cells.chunks if pa.types.is_list(chunk.type)]
    if pa.types.is_binary(cells.type):
        size = np.dtype(spec.type).itemsize
        found = [np.array([len(cell.as_buffer()) // size for cell in cells], dtype=np.int64)]
    return np.concatenate([*found, np.zeros(0, np.int64)])


def _flat(values: pa.ChunkedArray, spec: Column) -> Array:
    """Return all values of some cells, one cell after the other."""
    if pa.types.is_string(values.type):
        return np.array(values.to_pylist(), dtype=np.str_)
    if pa.types.is_binary(values.type):
        return (
            np.concatenate(
                [
                    np.zeros(0, spec.type),
                    *(np.frombuffer(cell.as_buffer(), dtype=spec.type) for cell in values),
                ]
            )
            if len(values) != 1
            else np.frombuffer(values[0].as_buffer(), dtype=spec.type)
        )
    if pa.types.is_list(values.type):
        parts = [chunk.flatten().to_numpy(zero_copy_only=False) for chunk in values.chunks]
    else:
        parts = [chunk.to_numpy(zero_copy_only=False) for chunk in values.chunks]
    if len(parts) == 1:
        return np.asarray(parts[0])
    dtype = np.dtype(pa.type_for_alias(spec.type).to_pandas_dtype())
    return np.concatenate([np.zeros(0, dtype), *parts])
