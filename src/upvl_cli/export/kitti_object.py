"""KITTI object: `training/label_2/NNNNNN.txt` with one line a box and `training/calib/NNNNNN.txt`, a number a frame.

`frames.csv` says which frame of which drive a number is. The format has no column for a track; a reader of its files
would stop at a further one, so the ids stand in `training/track_ids/NNNNNN.txt`, line by line as the labels.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import SCORE, TRACK, ExportFormat, ExportOptions
from upvl_cli.export.kitti_axes import boxes_of_labels, camera_from_ego, forward_camera, kitti_labels
from upvl_cli.export.kitti_lines import label_lines, read_lines
from upvl_cli.export.sweeps import write_picture, write_points_bin
from upvl_cli.export.text import floats_of, read_text
from upvl_cli.types import Array, Camera

CLASSES = {"vehicle": "Car", "pedestrian": "Pedestrian", "cyclist": "Cyclist", "other": "Misc"}
CLASSES |= {"car": "Car", "van": "Van", "truck": "Truck", "tram": "Tram", "person": "Pedestrian"}
_INDEX = ("number", "segment", "frame", "time_ns")


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one file of labels and one of calibration a frame."""
    training, number = folder / "training", 0
    for name in ("label_2", "calib", "track_ids"):
        (training / name).mkdir(parents=True)
    with (folder / "frames.csv").open("w", newline="", encoding="utf-8") as file:
        index = csv.writer(file, lineterminator="\n")
        index.writerow(_INDEX)
        for drive in drives:
            camera = forward_camera(drive, options.camera)
            count_camera(drive, camera, losses)
            calibration = calibration_text(camera)
            for frame in drive.frames:
                boxes = drive.boxes[drive.boxes.frame == frame.index]
                lines = label_lines(boxes, kitti_labels(boxes, camera, losses))
                name = f"{number:06d}"
                write_lines(training / "label_2" / f"{name}.txt", lines)
                write_lines(training / "track_ids" / f"{name}.txt", [str(track) for track in boxes.track_id])
                (training / "calib" / f"{name}.txt").write_text(calibration)
                index.writerow([name, drive.name, frame.index, frame.time_ns])
                if options.with_data:
                    write_points_bin(drive, frame.index, training / "velodyne" / f"{name}.bin")
                    write_picture(drive, frame.index, camera, training / "image_2" / f"{name}.png")
                number += 1


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all numbered frames."""
    parts: dict[str, list[tuple[Array, list[str], list[str], Array, int]]] = {}
    training = folder / "training"
    for number, segment, frame in _numbered_frames(folder / "frames.csv"):
        path = training / "label_2" / f"{number}.txt"
        if segment not in drives or not path.is_file():
            continue
        _, names, columns, score = read_lines(path, leading=0)
        transform = transform_of(training / "calib" / f"{number}.txt")
        ids = _ids(training / "track_ids" / f"{number}.txt", len(names), number)
        rows = boxes_of_labels(columns, transform)
        parts.setdefault(segment, []).append((rows, names, ids, score, frame))
    return {segment: _boxes_of_parts(found) for segment, found in parts.items()}


def _boxes_of_parts(parts: list[tuple[Array, list[str], list[str], Array, int]]) -> ExportBoxes:
    return boxes_of_rows(
        np.concatenate([rows for rows, *_ in parts]),
        class_name=np.array([name for _, names, *_ in parts for name in names], dtype=str),
        track_id=track_numbers([text for _, _, ids, *_ in parts for text in ids]),
        score=np.concatenate([score for *_, score, _ in parts]),
        frame=np.concatenate([np.full(len(rows), frame) for rows, *_, frame in parts]),
    )


def _numbered_frames(path: Path) -> Iterator[tuple[str, str, int]]:
    for line, row in enumerate(csv.DictReader(read_text(path).splitlines()), start=2):
        number, segment, frame = (row.get(name) or "" for name in _INDEX[:3])
        if not number.isdigit() or not frame.lstrip("-").isdigit():
            raise BadInput(f"{path}, line {line}: expected {', '.join(_INDEX)}")
        yield number, segment, int(frame)


def _ids(path: Path, boxes: int, number: str) -> list[str]:
    """Return the id of each line; ids of their own where a tool changed the lines or kept no such file."""
    ids = read_text(path).split() if path.is_file() else []
    return ids if len(ids) == boxes else [f"{number}-{line}" for line in range(boxes)]


def transform_of(path: Path) -> Array:
    """Return (4, 4) camera from ego, as R0_rect and Tr_velo_to_cam of a calibration file say."""
    fields = dict(line.split(":", 1) for line in read_text(path).splitlines() if ":" in line)
    found = {"R0_rect": 9, "Tr_velo_to_cam": 12}
    numbers = {key: floats_of(fields.get(key, "").split(), path, 1) for key in found}
    wrong = [key for key, count in found.items() if len(numbers[key]) != count]
    if wrong:
        raise BadInput(
            f"{path} has no {wrong[0]} of {found[wrong[0]]} numbers; copy the file that was exported"
        )
    rectify, transform = np.eye(4), np.eye(4)
    rectify[:3, :3] = np.reshape(numbers["R0_rect"], (3, 3))
    transform[:3] = np.reshape(numbers["Tr_velo_to_cam"], (3, 4))
    return rectify @ transform


def calibration_text(camera: Camera | None) -> str:
    """Return a calibration file whose rectified axes are those of the camera itself."""
    projection = np.zeros((3, 4))
    projection[:, :3] = np.eye(3) if camera is None else camera.intrinsic
    matrices = {f"P{number}": projection for number in range(4)}
    matrices |= {
        "R0_rect": np.eye(3),
        "Tr_velo_to_cam": camera_from_ego(camera)[:3],
        "Tr_imu_to_velo": np.eye(4)[:3],
    }
    lines = [
        f"{key}: " + " ".join(f"{value:.12e}" for value in matrix.flat) for key, matrix in matrices.items()
    ]
    return "\n".join(lines) + "\n"


def count_camera(drive: ExportDrive, camera: Camera | None, losses: Losses) -> None:
    """Count what a drive's cameras have and the format has not."""
    if camera is None:
        losses["drives without a camera: axes of one at the ego origin, looking forward"] += 1
    elif camera.distortion.any() or camera.distortion_model == "fisheye":
        losses["drives whose camera has a lens: calibration files hold its pinhole alone"] += 1
    losses["cameras beside the one whose picture the labels are in"] += max(len(drive.cameras) - 1, 0)


def write_lines(path: Path, lines: list[str]) -> None:
    """Write lines of text, each with its end."""
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


FORMAT = ExportFormat("kitti", write, read, frozenset({SCORE, TRACK}), CLASSES, fixed_classes=True)
