"""CSV: `<drive>.csv`, one row a box, in ego axes; columns as in the tables of upvl."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.text import read_text

_BOX = ("center_x_m", "center_y_m", "center_z_m", "length_m", "width_m", "height_m", "heading_rad")
_VELOCITY = ("velocity_x_mps", "velocity_y_mps", "velocity_z_mps")
_COLUMNS = ("segment", "frame", "time_ns", "track_id", "class", "score", *_BOX, *_VELOCITY, "num_points")
_NEEDED = ("frame", "track_id", "class", *_BOX)


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one table a drive."""
    for drive in drives:
        boxes, times_ns = drive.boxes, drive.times_ns[drive.places]
        with (folder / f"{drive.name}.csv").open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(_COLUMNS)
            rows = boxes.to_rows()
            for i in range(len(boxes)):
                table.writerow(
                    [
                        drive.name,
                        boxes.frame[i],
                        times_ns[i],
                        boxes.track_id[i],
                        boxes.class_name[i],
                        *(float(value) for value in (boxes.score[i], *rows[i], *boxes.velocity_mps[i])),
                        boxes.num_points[i],
                    ]
                )


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of each table that bears the name of a drive."""
    found = {name: folder / f"{name}.csv" for name in drives}
    return {name: _read_table(path) for name, path in found.items() if path.is_file()}


def _read_table(path: Path) -> ExportBoxes:
    lines = csv.DictReader(read_text(path).splitlines())
    missing = [name for name in _NEEDED if name not in (lines.fieldnames or ())]
    if missing:
        raise BadInput(f"{path} has no column {', '.join(missing)}; expected {', '.join(_NEEDED)}")
    rows = list(lines)

    def numbers(name: str, default: float) -> list[float]:
        return [_number(row.get(name) or default, name, line, path) for line, row in enumerate(rows, 2)]

    return boxes_of_rows(
        np.column_stack([numbers(name, np.nan) for name in _BOX]),
        frame=np.array(numbers("frame", -1)).astype(np.int64),
        track_id=track_numbers([row["track_id"] or "" for row in rows]),
        class_name=np.array([row["class"] or "" for row in rows], dtype=str),
        score=numbers("score", 1.0),
        velocity_mps=np.column_stack([numbers(name, np.nan) for name in _VELOCITY]),
        num_points=np.array(numbers("num_points", -1)).astype(np.int64),
    )


def _number(text: str | float, name: str, line: int, path: Path) -> float:
    try:
        return float(text)
    except ValueError:
        raise BadInput(f"{path}, line {line}: {name} is {str(text)[:40]!r}, expected a number") from None


FORMAT = ExportFormat("csv", write, read)
