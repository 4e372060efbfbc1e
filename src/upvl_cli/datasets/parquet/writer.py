"""Write drives as the tables of `dataset = "parquet"`: one sweep a row group, so that no drive is ever held."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.runtime.atomic import atomic_file
from upvl_cli.types import Array, Camera

_FLOATS = pa.list_(pa.float32())
_MATRIX = pa.list_(pa.float64(), 16)
_OPTIONAL = {
    "intensity": _FLOATS,
    "sensor": pa.list_(pa.uint8()),
    "time_offset_ns": pa.list_(pa.int32()),
}
CAMERAS = pa.schema(
    [
        ("camera", pa.string()), ("width_px", pa.int32()), ("height_px", pa.int32()), ("fx_px", pa.float64()),
        ("fy_px", pa.float64()), ("cx_px", pa.float64()), ("cy_px", pa.float64()),
        ("distortion_model", pa.string()), ("distortion", pa.list_(pa.float64())), ("ego_from_camera", _MATRIX),
    ]
)  # fmt: skip
IMAGES = pa.schema(
    [("frame", pa.int32()), ("camera", pa.string()), ("time_ns", pa.int64()), ("data", pa.binary())]
)
_BOX = ("center_x_m", "center_y_m", "center_z_m", "length_m", "width_m", "height_m", "heading_rad")


@dataclass(frozen=True, eq=False)
class PointsRow:
    """One row of `points`.

    Attributes:
        frame: Number of the frame.
        time_ns: Time of the sweep.
        world_from_ego: (4, 4) pose, or None.
        xyz_ego_m: (n, 3) points.
        values: (n,) of each optional column by name: `intensity`, `sensor`, `time_offset_ns`.
    """

    frame: int
    time_ns: int
    world_from_ego: Array | None
    xyz_ego_m: Array
    values: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class PictureRow:
    """One row of `images`: the JPEG or PNG that a camera took for a sweep."""

    frame: int
    camera: str
    time_ns: int
    data: bytes


@contextlib.contextmanager
def table_writer(path: Path, schema: pa.Schema, metadata: Mapping[str, str]) -> Iterator[pq.ParquetWriter]:
    """Open a table that appears at `path` only when the block ends well.

    Args:
        path: The file.
        schema: Its columns.
        metadata: Texts for its footer.
    """
    with atomic_file(path) as file, _opened(file, schema.with_metadata(dict(metadata))) as writer:
        yield writer


@contextlib.contextmanager
def _opened(file: IO[bytes], schema: pa.Schema) -> Iterator[pq.ParquetWriter]:
    # Floats that repeat are few: a dictionary of them only costs time.
    writer = pq.ParquetWriter(
        file, schema, compression="zstd", use_dictionary=["camera", "class", "track_id"]
    )
    try:
        yield writer
    finally:
        writer.close()


def points_schema(optional: Collection[str]) -> pa.Schema:
    """Return the columns of `points`.

    Args:
        optional: Those of `intensity`, `sensor` and `time_offset_ns` that the drive has.
    """
    return pa.schema(
        [
            ("frame", pa.int32()),
            ("time_ns", pa.int64()),
            ("world_from_ego", _MATRIX),
            *((name, _FLOATS) for name in ("x_m", "y_m", "z_m")),
            *((name, kind) for name, kind in _OPTIONAL.items() if name in optional),
        ]
    )


def sweep_table(row: PointsRow, schema: pa.Schema) -> pa.Table:
    """Return the row of `points` of one sweep; 0 for what this sweep lacks."""
    xyz = row.xyz_ego_m.astype(np.float32)
    columns: list[list[Any]] = [[row.frame], [row.time_ns], [_matrix(row.world_from_ego)]]
    columns += [[np.ascontiguousarray(xyz[:, axis])] for axis in range(3)]
    for name in schema.names[len(columns) :]:
        dtype = schema.field(name).type.value_type.to_pandas_dtype()
        columns.append([row.values[name].astype(dtype) if name in row.values else np.zeros(len(xyz), dtype)])
    return _table(columns, schema)


def picture_table(row: PictureRow) -> pa.Table:
    """Return the row of `images` of one picture."""
    return _table([[row.frame], [row.camera], [row.time_ns], [row.data]], IMAGES)


def write_cameras(path: Path, cameras: Iterable[Camera], metadata: Mapping[str, str]) -> None:
    """Write `cameras`: one row a camera."""
    with table_writer(path, CAMERAS, metadata) as writer:
        for camera in cameras:
            model = camera.distortion_model if camera.distortion.any() else "none"
            if camera.distortion_model == "fisheye":
                model = "fisheye"  # without distortion it still is no pinhole
            intrinsic = camera.intrinsic
            row = [
                camera.name, camera.width_px, camera.height_px, intrinsic[0, 0], intrinsic[1, 1], intrinsic[0, 2],
                intrinsic[1, 2], model, [] if model == "none" else camera.distortion.tolist(),
                _matrix(camera.ego_from_camera),
            ]  # fmt: skip
            writer.write_table(_table([[value] for value in row], CAMERAS))


def _table(columns: Iterable[list[Any]], schema: pa.Schema) -> pa.Table:
    arrays = [pa.array(column, kind.type) for column, kind in zip(columns, schema, strict=True)]
    return pa.Table.from_arrays(arrays, schema=schema)


def _matrix(pose: Array | None) -> list[float] | None:
    return None if pose is None else [float(number) for number in np.asarray(pose).ravel()]
