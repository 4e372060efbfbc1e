"""nuScenes results: `results.json`, a submission for detection and for tracking in one file.

The devkit's classes of both tasks take what they know of a box and pass over the rest: `class_name` keeps a class that
is a kind of theirs. `samples.json` says which frame
of which drive a sample is, and where the car was: boxes are in the axes of the world. What the devkit would refuse
stands in `other.json`: boxes of other classes, and those between the key frames of nuScenes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.datasets.nuscenes.calibration import pose_of, poses_of
from upvl_cli.datasets.nuscenes.tables import Row, number_of, numbers_of, read_table, shown, text_of
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import SCORE, TRACK, VELOCITY, ExportFormat, ExportOptions
from upvl_cli.export.frame_times import time_us
from upvl_cli.export.json_items import JsonItems
from upvl_cli.export.nuscenes_names import TASK_CLASSES, attributes_of, sample_tokens, task_class
from upvl_cli.export.nuscenes_read import sizes_lwh_m
from upvl_cli.export.text import read_json
from upvl_cli.export.world_axes import (
    boxes_in_world,
    count_vertical,
    quaternions_wxyz,
    rows_in_ego,
    velocity_in_ego,
)
from upvl_cli.types import Array

RESULTS, OTHER, SAMPLES = "results.json", "other.json", "samples.json"
_META = {  # what the labels of upvl are made from
    "use_camera": True,
    "use_lidar": True,
    "use_radar": False,
    "use_map": False,
    "use_external": True,
}
_TASK_NAMES = frozenset(TASK_CLASSES.values())
_MOST_BOXES = 500  # of a sample, in both tasks
_MAX_FRAME = 2**62


@dataclass(frozen=True)
class SampleFrame:
    """The frame that a sample is.

    Attributes:
        segment: Name of the drive.
        frame: Index of the frame.
        world_from_ego: (4, 4) pose of the car in the axes of the boxes.
    """

    segment: str
    frame: int
    world_from_ego: Array


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write the results of all drives, and the table of samples."""
    opening = f'{{"meta": {json.dumps(_META)}, "results": {{'
    with (
        JsonItems(folder / RESULTS, opening, "}}") as results,
        JsonItems(folder / OTHER, opening, "}}") as others,
        JsonItems(folder / SAMPLES) as samples,
    ):
        for drive in drives:
            _count_velocities(drive, losses)
            items = _items(drive, losses)
            places, rotations = drive.places, quaternions_wxyz(drive.world_from_ego)
            for place, (token, is_scored) in enumerate(sample_tokens(drive)):
                frame = drive.frames[place]
                samples.add(
                    {
                        "token": token,
                        "segment": drive.name,
                        "frame": frame.index,
                        "timestamp": time_us(frame.time_ns),
                        "translation": drive.world_from_ego[place, :3, 3].tolist(),
                        "rotation": rotations[place].tolist(),
                    }
                )
                here = [{"sample_token": token} | items[i] for i in np.flatnonzero(places == place)]
                taken = [item for item in here if item["tracking_name"] in _TASK_NAMES]
                _count_refused(len(here), len(taken), is_scored, losses)
                if is_scored:
                    results.add(taken, token)
                    here = [item for item in here if item["tracking_name"] not in _TASK_NAMES]
                if here:
                    others.add(here, token)


def _items(drive: ExportDrive, losses: Losses) -> list[dict[str, Any]]:
    """Return the boxes as the classes of the devkit take them, without the token of their sample."""
    boxes = drive.boxes
    own = [str(name) for name in boxes.class_name]
    names = [task_class(name) or name for name in own]
    for name, task in zip(own, names, strict=True):
        if name != task:
            losses[
                f"boxes of class {name!r}: written as {task}, the class in the further key class_name"
            ] += 1
    attributes = attributes_of(drive, names)
    center_m, wxyz = boxes_in_world(drive)
    velocity = np.nan_to_num(drive.velocity_world_mps())
    return [
        {
            "translation": center_m[i].tolist(),
            "size": boxes.size_lwh_m[i, [1, 0, 2]].tolist(),
            "rotation": wxyz[i].tolist(),
            "velocity": velocity[i, :2].tolist(),
            "detection_name": name,
            "detection_score": float(boxes.score[i]),
            "attribute_name": attributes[i],
            "tracking_id": str(boxes.track_id[i]),
            "tracking_name": name,
            "tracking_score": float(boxes.score[i]),
        }
        | ({"class_name": own[i]} if own[i] != name else {})
        for i, name in enumerate(names)
    ]


def _count_velocities(drive: ExportDrive, losses: Losses) -> None:
    velocity = drive.velocity_world_mps()
    losses["boxes without a velocity: written as 0, as the devkit wants one"] += int(
        np.isnan(velocity).any(axis=1).sum()
    )
    losses["velocities that point up or down: written along the world's x and y alone"] += count_vertical(
        velocity
    )


def _count_refused(boxes: int, known: int, is_scored: bool, losses: Losses) -> None:
    losses[f"boxes of a class that the tasks of nuScenes have not: written to {OTHER}"] += boxes - known
    if not is_scored:
        losses[f"boxes between the key frames of nuScenes: written to {OTHER}"] += known
    elif known > _MOST_BOXES:
        losses[f"samples with more than {_MOST_BOXES} boxes, which the devkit refuses"] += 1


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of every file of results in the folder."""
    samples = _samples(folder / SAMPLES, drives)
    rows: dict[str, list[tuple[Row, SampleFrame]]] = {}
    for path in sorted(folder.glob("*.json")):
        content = read_json(path) if path.name != SAMPLES else None
        results = content.get("results") if isinstance(content, dict) else None
        if results is None:
            continue  # another file beside the results, for example what upvl wrote of the export
        for token, items in _items_by_sample(results, path):
            if token not in samples:
                raise BadInput(
                    f"{path}: sample {shown(token)} is no frame of a drive of this workspace; keep {SAMPLES} beside it"
                )
            sample = samples[token]
            rows.setdefault(sample.segment, []).extend((item, sample) for item in items)
    return {name: _boxes_of(rows[name], folder) for name in drives if name in rows}


def _items_by_sample(results: Any, path: Path) -> Iterator[tuple[str, list[Row]]]:
    """Yield the token of each sample and its boxes, each of which gets a name for messages."""
    if not isinstance(results, dict):
        raise BadInput(f"{path}: results is {shown(results)}, expected an object with a list for each sample")
    for token, items in results.items():
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise BadInput(f"{path}: sample {shown(token)} is {shown(items)}, expected a list of boxes")
        yield token, [item | {"token": f"{token}-{number}"} for number, item in enumerate(items)]


def _samples(path: Path, drives: Mapping[str, ExportDrive]) -> dict[str, SampleFrame]:
    """Return the frame of each sample: as the table says, or else as upvl would call it."""
    if not path.is_file():
        return {
            token: SampleFrame(name, frame.index, pose)
            for name, drive in drives.items()
            for (token, _), frame, pose in zip(
                sample_tokens(drive), drive.frames, drive.world_from_ego, strict=True
            )
        }
    return {
        text_of(row, "token", path): SampleFrame(
            text_of(row, "segment", path),
            int(number_of(row, "frame", path, most=_MAX_FRAME)),
            pose_of(row, path),
        )
        for row in read_table(path)
    }


def _boxes_of(found: list[tuple[Row, SampleFrame]], folder: Path) -> ExportBoxes:
    rows = [row for row, _ in found]
    poses = np.array([sample.world_from_ego for _, sample in found]).reshape(-1, 4, 4)
    return boxes_of_rows(
        rows_in_ego(poses_of(rows, folder), sizes_lwh_m(rows, folder), poses),
        frame=np.array([sample.frame for _, sample in found], dtype=np.int64),
        track_id=track_numbers([str(row.get("tracking_id", row["token"])) for row in rows]),
        class_name=np.array([_class_name(row, folder) for row in rows], dtype=str),
        score=np.array([_score(row, folder) for row in rows], dtype=np.float64),
        velocity_mps=velocity_in_ego(_velocities(rows, folder), poses),
    )


def _class_name(row: Row, path: Path) -> str:
    """Return the class; a file of one task has its name alone."""
    keys = ("class_name", "detection_name", "tracking_name")
    return text_of(row, next((key for key in keys if key in row), keys[-1]), path)


def _score(row: Row, path: Path) -> float:
    for name in ("detection_score", "tracking_score"):
        if name in row:
            return float(number_of(row, name, path))
    return 1.0


def _velocities(rows: list[Row], path: Path) -> Array:
    """Return (n, 3) velocities in the axes of the world, level there; NaN where a row has none."""
    found = np.full((len(rows), 3), np.nan)
    for i, row in enumerate(rows):
        if row.get("velocity") is not None:
            found[i] = [*numbers_of(row, "velocity", 2, path), 0.0]
    return found


FORMAT = ExportFormat("nuscenes-results", write, read, frozenset({SCORE, VELOCITY, TRACK}), TASK_CLASSES)
