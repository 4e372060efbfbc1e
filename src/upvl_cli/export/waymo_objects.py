"""Waymo objects: `objects.bin`, a message `Objects` as the tools of the Waymo Open Dataset take predictions.

`classes.csv` keeps the classes that Waymo has not. Numbers of fields after label.proto, protos/metrics.proto and
protos/submission.proto of waymo-open-dataset.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from upvl_cli.datasets.waymo.wire import Message
from upvl_cli.errors import BadInput, one_line
from upvl_cli.export import waymo_wire as wire
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.frame_times import frames_at_us, time_us
from upvl_cli.export.text import read_text
from upvl_cli.export.waymo_types import (
    CLASSES,
    class_names,
    count_types,
    is_named_otherwise,
    type_numbers,
)
from upvl_cli.export.world_axes import velocity_in_ego
from upvl_cli.geometry.se3 import wrap_angle

_FILE, _CLASSES = "objects.bin", "classes.csv"
_COLUMNS = ("segment", "timestamp_micros", "id", "class")
_MAX_BYTES = 2**30
_INT32 = 2**31
# Fields of the messages Submission, Objects, Object, Label, Label.Box and Label.Metadata.
_INFERENCE_RESULTS, _OBJECTS = 11, 1
_LABEL, _SCORE, _CONTEXT, _TIMESTAMP = 1, 2, 4, 5
_BOX, _METADATA, _TYPE, _ID, _POINTS = 1, 2, 3, 4, 7
_CENTER_X, _CENTER_Y, _CENTER_Z, _WIDTH, _LENGTH, _HEIGHT, _HEADING = range(1, 8)
_BOX_FIELDS = (_CENTER_X, _CENTER_Y, _CENTER_Z, _LENGTH, _WIDTH, _HEIGHT, _HEADING)
_SPEED_FIELDS = (1, 2, 5)


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write the boxes of all drives into one file."""
    with (
        (folder / _FILE).open("wb") as file,
        (folder / _CLASSES).open("w", newline="", encoding="utf-8") as names,
    ):
        table = csv.writer(names, lineterminator="\n")
        table.writerow(_COLUMNS)
        for drive in drives:
            count_data(options, losses)
            boxes, types = drive.boxes, type_numbers(drive.boxes)
            count_types(boxes, types, _CLASSES, losses)
            times = [time_us(time_ns) for time_ns in drive.times_ns[drive.places]]
            for content in _objects(drive, types.tolist(), times):
                file.write(wire.message(_OBJECTS, content))
            for i in np.flatnonzero(is_named_otherwise(boxes, types)):
                table.writerow([drive.name, times[i], boxes.track_id[i], boxes.class_name[i]])


def count_data(options: ExportOptions, losses: Losses) -> None:
    """Count the drives whose points and pictures were asked for: labels of Waymo lie beside its own files."""
    if options.with_data:
        losses["drives whose points and pictures Waymo's format of labels has no place for"] += 1


def _objects(drive: ExportDrive, types: list[int], times: list[int]) -> Iterable[bytes]:
    """Yield the message of each box."""
    boxes, velocity = drive.boxes, drive.velocity_world_mps()
    rows = boxes.to_rows()
    rows[:, 6] = wrap_angle(rows[:, 6])
    for i in range(len(boxes)):
        box = b"".join(
            wire.double(field, value) for field, value in zip(_BOX_FIELDS, rows[i].tolist(), strict=True)
        )
        label = wire.message(_BOX, box)
        if np.isfinite(velocity[i]).all():
            speed = zip(_SPEED_FIELDS, velocity[i].tolist(), strict=True)
            label += wire.message(_METADATA, b"".join(wire.double(field, value) for field, value in speed))
        label += wire.whole_number(_TYPE, types[i]) + wire.text(_ID, str(boxes.track_id[i]))
        if boxes.num_points[i] >= 0:
            label += wire.whole_number(_POINTS, min(int(boxes.num_points[i]), _INT32 - 1))
        yield (
            wire.message(_LABEL, label)
            + wire.single(_SCORE, float(boxes.score[i]))
            + wire.text(_CONTEXT, drive.name)
            + wire.whole_number(_TIMESTAMP, times[i])
        )


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all files with objects, or with a whole submission."""
    named = _read_classes(folder / _CLASSES)
    found: dict[str, list[Message]] = {}
    for path in sorted(folder.glob("*.bin")):
        content = Message(_read_bytes(path), str(path))
        if _INFERENCE_RESULTS in content:
            content = content.message(_INFERENCE_RESULTS)
        for item in content.messages(_OBJECTS):
            name = item.text(_CONTEXT)
            if name in drives:
                found.setdefault(name, []).append(item)
    return {name: _boxes_of(items, drives[name], named) for name, items in found.items()}


def _boxes_of(
    items: list[Message], drive: ExportDrive, named: Mapping[tuple[str, int, str], str]
) -> ExportBoxes:
    labels = [item.message(_LABEL) for item in items]
    boxes = [label.message(_BOX) for label in labels]
    times = [item.number(_TIMESTAMP) for item in items]
    ids = [label.text(_ID) for label in labels]
    types = class_names(np.array([label.number(_TYPE) for label in labels]))
    keys = [(drive.name, time, track) for time, track in zip(times, ids, strict=True)]
    frame = frames_at_us(drive, times, items[0].where)
    poses = drive.world_from_ego[drive.places_of(frame)]
    return boxes_of_rows(
        np.array([[box.double(field) for field in _BOX_FIELDS] for box in boxes]),
        frame=frame,
        # A submission for detection has no ids: each of its boxes is a track of its own.
        track_id=track_numbers([track or f"object-{i}" for i, track in enumerate(ids)]),
        class_name=np.array([named.get(key, name) for key, name in zip(keys, types, strict=True)], dtype=str),
        score=np.array([item.single(_SCORE) if _SCORE in item else 1.0 for item in items]),
        velocity_mps=velocity_in_ego(np.array([_velocity(label) for label in labels]), poses),
        num_points=np.array([label.number(_POINTS) if _POINTS in label else -1 for label in labels]),
    )


def _velocity(label: Message) -> list[float]:
    """Return the velocity of a label in the axes of the world."""
    if _METADATA not in label:
        return [np.nan] * 3
    metadata = label.message(_METADATA)
    return [metadata.double(field) for field in _SPEED_FIELDS]


def _read_classes(path: Path) -> dict[tuple[str, int, str], str]:
    """Return the classes that Waymo has not, by drive, time and id; none where there is no such file."""
    if not path.is_file():
        return {}
    named = {}
    for line, row in enumerate(csv.DictReader(read_text(path).splitlines()), start=2):
        segment, time, track, name = (row.get(column) or "" for column in _COLUMNS)
        if not time.isdigit() or len(time) > 18 or not name:
            raise BadInput(f"{path}, line {line}: expected {', '.join(_COLUMNS)}")
        named[segment, int(time), track] = name
    return named


def _read_bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise BadInput(f"{path} is larger than {_MAX_BYTES >> 20} MiB; split it into several files")
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"cannot read {path}: {error.strerror or one_line(error)}") from None


FORMAT = ExportFormat("waymo", write, read, classes=CLASSES)
