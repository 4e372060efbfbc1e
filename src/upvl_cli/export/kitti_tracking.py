"""KITTI tracking: `training/label_02/NNNN.txt`, one line a box with frame and track, and `training/calib/NNNN.txt`.

A drive is a number (`drives.csv` says which); frames count from 0 within it.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import SCORE, TRACK, ExportFormat, ExportOptions
from upvl_cli.export.kitti_axes import boxes_of_labels, forward_camera, kitti_labels
from upvl_cli.export.kitti_lines import label_lines, read_lines
from upvl_cli.export.kitti_object import CLASSES, calibration_text, count_camera, transform_of, write_lines
from upvl_cli.export.sweeps import write_picture, write_points_bin
from upvl_cli.export.text import read_text

_INDEX = ("number", "segment")


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one file of labels and one of calibration a drive."""
    training = folder / "training"
    for name in ("label_02", "calib"):
        (training / name).mkdir(parents=True)
    with (folder / "drives.csv").open("w", newline="", encoding="utf-8") as file:
        index = csv.writer(file, lineterminator="\n")
        index.writerow(_INDEX)
        for number, drive in enumerate(drives):
            name = f"{number:04d}"
            camera = forward_camera(drive, options.camera)
            count_camera(drive, camera, losses)
            lines = label_lines(drive.boxes, kitti_labels(drive.boxes, camera, losses))
            keys = zip(drive.places, drive.boxes.track_id, lines, strict=True)
            write_lines(
                training / "label_02" / f"{name}.txt", [f"{at} {track} {line}" for at, track, line in keys]
            )
            (training / "calib" / f"{name}.txt").write_text(calibration_text(camera))
            index.writerow([name, drive.name])
            for place, frame in enumerate(drive.frames if options.with_data else ()):
                write_points_bin(drive, frame.index, training / "velodyne" / name / f"{place:06d}.bin")
                write_picture(drive, frame.index, camera, training / "image_02" / name / f"{place:06d}.png")


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all numbered drives."""
    found = {}
    path = folder / "drives.csv"
    for row in csv.DictReader(read_text(path).splitlines()):
        number, segment = (row.get(name) or "" for name in _INDEX)
        if not number.isdigit():
            raise BadInput(f"{path}: expected the columns {', '.join(_INDEX)}")
        if segment in drives:
            found[segment] = _read_drive(folder / "training", number, drives[segment])
    return found


def _read_drive(training: Path, number: str, drive: ExportDrive) -> ExportBoxes:
    path = training / "label_02" / f"{number}.txt"
    heads, names, columns, score = read_lines(path, leading=2)
    places = [int(place) if place.isdigit() else -1 for place, _ in heads]
    outside = [place for place in places if not 0 <= place < len(drive.frames)]
    if outside:
        raise BadInput(
            f"{path} has a box of frame {outside[0]}; drive {drive.name} has 0 to {len(drive.frames) - 1}"
        )
    return boxes_of_rows(
        boxes_of_labels(columns, transform_of(training / "calib" / f"{number}.txt")),
        class_name=np.array(names, dtype=str),
        track_id=track_numbers([track for _, track in heads]),
        score=score,
        frame=np.array([drive.frames[place].index for place in places], dtype=np.int64),
    )


FORMAT = ExportFormat("kitti-tracking", write, read, frozenset({SCORE, TRACK}), CLASSES, fixed_classes=True)
