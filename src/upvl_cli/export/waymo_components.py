"""Waymo v2: `lidar_box/<drive>.parquet` and `vehicle_pose/<drive>.parquet`, components of the Waymo Open Dataset.

Columns as its classes LiDARBoxComponent and VehiclePoseComponent have them, and two further ones for what Waymo has
no place for, which its tools pass over.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from upvl_cli.datasets.shared import arrow
from upvl_cli.datasets.waymo.components import POSE, SEGMENT, TIME, component_path, in_segment
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.frame_times import frames_at_us, time_us
from upvl_cli.export.waymo_objects import count_data
from upvl_cli.export.waymo_types import CLASSES, class_names, count_types, type_numbers
from upvl_cli.export.world_axes import velocity_in_ego
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.types import Array

_BOXES, _POSES = "lidar_box", "vehicle_pose"
_ID, _COMPONENT = "key.laser_object_id", "[LiDARBoxComponent]."
_BOX = [
    *(f"{_COMPONENT}box.center.{axis}" for axis in "xyz"),
    *(f"{_COMPONENT}box.size.{axis}" for axis in "xyz"),
    f"{_COMPONENT}box.heading",
]
_TYPE, _POINTS = f"{_COMPONENT}type", f"{_COMPONENT}num_lidar_points_in_box"
_SPEED = [f"{_COMPONENT}speed.{axis}" for axis in "xyz"]
_CLASS, _SCORE = "upvl.class_name", "upvl.score"
# What upvl does not know, and leaves empty.
_EMPTY_BEFORE = {f"{_COMPONENT}num_top_lidar_points_in_box": pa.int64()}
_EMPTY_AFTER = {
    **{f"{_COMPONENT}acceleration.{axis}": pa.float64() for axis in "xyz"},
    f"{_COMPONENT}difficulty_level.detection": pa.int8(),
    f"{_COMPONENT}difficulty_level.tracking": pa.int8(),
}


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write both components of each drive."""
    for component in (_BOXES, _POSES):
        (folder / component).mkdir()
    for drive in drives:
        count_data(options, losses)
        pq.write_table(_boxes_table(drive, losses), folder / _BOXES / f"{drive.name}.parquet")
        times = [time_us(time_ns) for time_ns in drive.times_ns]
        poses = pa.FixedSizeListArray.from_arrays(pa.array(drive.world_from_ego.reshape(-1)), 16)
        table = pa.table(
            {SEGMENT: _repeated(drive.name, times), TIME: pa.array(times, pa.int64()), POSE: poses}
        )
        pq.write_table(table, folder / _POSES / f"{drive.name}.parquet")


def _repeated(name: str, rows: list[int]) -> pa.Array:
    return pa.array([name] * len(rows), pa.string())


def _boxes_table(drive: ExportDrive, losses: Losses) -> pa.Table:
    boxes, types = drive.boxes, type_numbers(drive.boxes)
    count_types(boxes, types, f"the further column {_CLASS}", losses)
    times = [time_us(time_ns) for time_ns in drive.times_ns[drive.places]]
    rows = boxes.to_rows()
    rows[:, 6] = wrap_angle(rows[:, 6])
    velocity = drive.velocity_world_mps()
    columns: dict[str, pa.Array] = {
        SEGMENT: _repeated(drive.name, times),
        TIME: pa.array(times, pa.int64()),
        _ID: pa.array([str(track) for track in boxes.track_id], pa.string()),
        **{name: pa.array(column) for name, column in zip(_BOX, rows.T.copy(), strict=True)},
        _TYPE: pa.array(types.astype(np.int8)),
        _POINTS: pa.array(boxes.num_points, mask=boxes.num_points < 0),
        **{name: pa.nulls(len(boxes), kind) for name, kind in _EMPTY_BEFORE.items()},
        **{
            name: pa.array(column, mask=np.isnan(column))
            for name, column in zip(_SPEED, velocity.T.copy(), strict=True)
        },
        **{name: pa.nulls(len(boxes), kind) for name, kind in _EMPTY_AFTER.items()},
        _CLASS: pa.array(boxes.class_name.tolist(), pa.string()),
        _SCORE: pa.array(boxes.score),
    }
    return pa.table(columns)


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of each drive that has a file of them."""
    paths = {name: component_path(folder, _BOXES, name) for name in drives}
    return {name: _read_boxes(path, drives[name]) for name, path in paths.items() if path is not None}


def _read_boxes(path: Path, drive: ExportDrive) -> ExportBoxes:
    optional = (_POINTS, *_SPEED, _CLASS, _SCORE)
    table = arrow.read_parquet(path, [SEGMENT, TIME, _ID, *_BOX, _TYPE], optional)
    with arrow.arrow_errors(path):
        table = table.filter(pa.array(in_segment(table, drive.name, path)))

    def numbers(name: str, missing: float) -> Array:
        if name not in table.column_names:
            return np.full(len(table), missing)
        found = arrow.floats_or_nan(table, name, path)
        return np.where(np.isfinite(found), found, missing)

    frame = frames_at_us(drive, arrow.values(table, TIME, "int64", path), path)
    poses = drive.world_from_ego[drive.places_of(frame)]
    types = class_names(arrow.values(table, _TYPE, "int64", path))
    with arrow.arrow_errors(f"{path}, column {_CLASS}"):
        own = table[_CLASS].to_pylist() if _CLASS in table.column_names else [None] * len(table)
    velocity = np.column_stack([numbers(name, np.nan) for name in _SPEED])
    return boxes_of_rows(
        np.column_stack([arrow.values(table, name, "float64", path) for name in _BOX]),
        frame=frame,
        track_id=track_numbers(arrow.texts(table, _ID, path)),
        class_name=np.array([str(name or kind) for name, kind in zip(own, types, strict=True)], dtype=str),
        score=numbers(_SCORE, 1.0),
        velocity_mps=velocity_in_ego(velocity, poses),
        num_points=numbers(_POINTS, -1).clip(-1, 2**31).astype(np.int64),
    )


FORMAT = ExportFormat("waymo-parquet", write, read, classes=CLASSES)
