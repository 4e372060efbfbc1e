"""The table `points/<segment>.parquet`: one row a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from upvl_cli.datasets.shared.arrow import (
    check_columns,
    integers,
    is_list,
    matrices,
    metadata_text,
    open_parquet,
    read_parquet,
)
from upvl_cli.datasets.shared.parquet_columns import ListColumn
from upvl_cli.datasets.shared.poses import check_pose
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Frame, Points

_AXES = ("x_m", "y_m", "z_m")
_OPTIONAL = {"intensity": "float32", "elongation": "float32", "sensor": "uint8", "time_offset_ns": "int64"}
_MAX_M = 1e4  # a LiDAR sees a few hundred metres; farther is no place but a damaged number
_MAX_OFFSET_NS = 2_000_000_000  # a slow sweep takes half a second
_ROUNDING = 1e-3  # an intensity may be so far out of 0 to 1: float16 and rounded writers


@dataclass(frozen=True, eq=False)
class PointTable:
    """The sweeps of a drive.

    Attributes:
        path: The file.
        frames: The frames, one a row.
        world_from_ego: (T, 4, 4) poses, or None.
        is_compensated: Whether the points are motion-compensated to the time of their frame.
    """

    path: Path
    frames: tuple[Frame, ...]
    world_from_ego: Array | None
    is_compensated: bool
    _columns: Mapping[str, ListColumn]

    def read(self, row: int) -> tuple[Points, int]:
        """Return the sweep of a row as stored, and how many points without a place it was written with.

        Raises:
            BadInput: A cell is not what it has to be.
        """
        xyz = [self._cell(name, "float32", row) for name in _AXES]
        total = len(xyz[0])
        parts = {
            name: self._cell(name, dtype, row) for name, dtype in _OPTIONAL.items() if name in self._columns
        }
        lengths = {
            name: len(cell) for name, cell in zip((*_AXES, *parts), (*xyz, *parts.values()), strict=True)
        }
        if len(set(lengths.values())) > 1:
            raise BadInput(
                f"{self.path}, row {row} has lists of different lengths: {lengths}; write it again"
            )
        xyz_m = np.stack(xyz, axis=1)
        is_place = np.isfinite(xyz_m).all(axis=1)
        far = np.abs(xyz_m[is_place]).max(initial=0.0)
        if far > _MAX_M:
            raise BadInput(
                f"{self.path}, row {row} has a point {far:.3g} m away, expected metres up to {_MAX_M:g}; "
                "check the unit, and write it again"
            )
        zeros = np.zeros(total, np.float32)
        offset_ns = parts.get("time_offset_ns", np.zeros(total, np.int64))
        if np.abs(offset_ns).max(initial=0) > _MAX_OFFSET_NS:
            raise BadInput(
                f"{self.path}, row {row} has a time_offset_ns of {int(offset_ns[np.abs(offset_ns).argmax()])}, "
                f"expected nanoseconds within {_MAX_OFFSET_NS} of the sweep's time"
            )
        points = Points(
            xyz_ego_m=xyz_m,
            intensity=self._intensity(parts.get("intensity", zeros), row),
            elongation=np.nan_to_num(parts.get("elongation", zeros), posinf=0.0, neginf=0.0),
            sensor=parts.get("sensor", np.zeros(total, np.uint8)),
            time_offset_ns=offset_ns,
        )
        return (points, 0) if is_place.all() else (points[is_place], int((~is_place).sum()))

    def _cell(self, name: str, dtype: str, row: int) -> Array:
        found = self._columns[name].row(row)
        if found is None:  # an empty list: a sweep without points
            return np.zeros(0, dtype)
        if found.dtype.kind == "f" and np.dtype(dtype).kind in "iu" and not (found == np.floor(found)).all():
            raise BadInput(f"{self.path}, column {name}, row {row} holds fractions, expected {dtype}")
        limits = np.iinfo(dtype) if np.dtype(dtype).kind in "iu" else None
        if limits and len(found) and not (found.min() >= limits.min and found.max() <= limits.max):
            raise BadInput(
                f"{self.path}, column {name}, row {row} holds {found.min()} to {found.max()}, expected {dtype}: "
                f"{limits.min} to {limits.max}"
            )
        with np.errstate(over="ignore"):  # beyond single precision is infinitely far: no place
            return found.astype(dtype)

    def _intensity(self, intensity: Array, row: int) -> Array:
        intensity = np.nan_to_num(intensity, nan=0.0, posinf=np.inf, neginf=-np.inf)
        low, high = intensity.min(initial=0.0), intensity.max(initial=0.0)
        if low < -_ROUNDING or high > 1 + _ROUNDING:
            raise BadInput(
                f"{self.path}, row {row} has intensities from {low:.3g} to {high:.3g}, expected 0 to 1; "
                "divide them by what the sensor gives at most, for example 255"
            )
        return np.clip(intensity, 0.0, 1.0)


def open_points(path: Path) -> PointTable:
    """Return the sweeps of a drive; only frames, times and poses are read.

    Raises:
        BadInput: The file is no such table.
    """
    file = open_parquet(path)
    names = file.schema_arrow.names
    check_columns(names, ("frame", "time_ns", *_AXES), path)
    optional = [name for name in _OPTIONAL if name in names]
    for name in (*_AXES, *optional):
        if not is_list(file.schema_arrow.field(name).type):
            kind = file.schema_arrow.field(name).type
            raise BadInput(
                f"{path}: the column {name} is of type {kind}, expected a list of numbers in each row"
            )
    compensated = metadata_text(file.metadata.metadata, "motion_compensated", path) or "true"
    if compensated not in ("true", "false"):
        raise BadInput(f"{path}: motion_compensated is {compensated[:40]!r}, expected true or false")
    table = read_parquet(path, ("frame", "time_ns"), ("world_from_ego",))
    index, time_ns = (integers(table, name, path).tolist() for name in ("frame", "time_ns"))
    if not index:
        raise BadInput(f"{path} has no row, expected one a sweep")
    frames = check_frames([Frame(*pair) for pair in zip(index, time_ns, strict=True)], path)
    columns = {name: ListColumn(path, name) for name in (*_AXES, *optional)}
    return PointTable(path, frames, _poses(table, path), compensated == "true", columns)


def _poses(table: pa.Table, path: Path) -> Array | None:
    if "world_from_ego" not in table.column_names:
        return None
    cells = matrices(table, "world_from_ego", 16, path)
    return None if cells is None else check_pose(cells.reshape(-1, 4, 4), f"{path}: world_from_ego")
