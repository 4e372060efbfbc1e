"""Xtreme1: `scene_<drive>/result/<frame>.json`, with data the folders that its upload takes, to be packed as one zip.

`lidar_point_cloud_0/<frame>.pcd`, `camera_image_<n>/<frame>.png`, `camera_config/<frame>.json` (docs of Xtreme1, upload
dataset, data annotation result, coordinate system). Boxes are in the axes of the points: centre, sizes along the
box's x, y and z, angles in radians. The upload refuses a result without objects: frames without boxes have no file.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import POINTS, SCORE, TRACK, ExportFormat, ExportOptions
from upvl_cli.export.json_value import JsonValue
from upvl_cli.export.sweeps import write_picture, write_points_pcd
from upvl_cli.export.tool_files import (
    FoundBoxes,
    boxes_of_frame,
    drive_folders,
    frame_name,
    frame_of_name,
    write_json,
    xyz_object,
)
from upvl_cli.geometry.se3 import inverse
from upvl_cli.types import Camera

_SCENE, _RESULT = "scene_", "result"
_SPACE = uuid.UUID(
    "5c1f3a52-6e0b-5d0e-9c39-2f4d5a0f5c12"
)  # ids depend on names alone: same labels, same bytes


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one scene a drive."""
    for drive in drives:
        own = folder / f"{_SCENE}{drive.name}"
        (own / _RESULT).mkdir(parents=True)
        for frame in drive.frames:
            boxes, name = boxes_of_frame(drive, frame.index), frame_name(frame.index)
            if len(boxes):
                objects = [_object(boxes, i, drive.name) for i in range(len(boxes))]
                write_json(own / _RESULT / f"{name}.json", {"sourceName": "upvl", "objects": objects})
            if options.with_data:
                _write_data(drive, frame.index, own, name)


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all scenes, whose folders bear the names of drives, with or without "scene_"."""
    return {name: _read_scene(own) for name, own, _ in drive_folders(folder, drives, _RESULT, _SCENE)}


def _object(boxes: ExportBoxes, i: int, drive_name: str) -> dict[str, Any]:
    track, name = str(boxes.track_id[i]), str(boxes.class_name[i])
    contour = {
        "pointN": int(max(boxes.num_points[i], 0)),
        "points": [],
        "size3D": xyz_object(boxes.size_lwh_m[i]),
        "center3D": xyz_object(boxes.center_m[i]),
        "viewIndex": 0,
        "rotation3D": xyz_object(np.array([0.0, 0.0, boxes.heading_rad[i]])),
    }
    return {
        "id": str(uuid.uuid5(_SPACE, f"{drive_name}/{boxes.frame[i]}/{track}")),
        "type": "3D_BOX",
        "className": name,
        "modelClass": name,
        "modelConfidence": float(boxes.score[i]) if np.isfinite(boxes.score[i]) else None,
        "trackId": track,
        "trackName": track,
        "classValues": [],
        "contour": contour,
    }


def _write_data(drive: ExportDrive, frame: int, folder: Path, name: str) -> None:
    write_points_pcd(drive, frame, folder / "lidar_point_cloud_0" / f"{name}.pcd")
    for number, camera in enumerate(drive.cameras):
        write_picture(drive, frame, camera, folder / f"camera_image_{number}" / f"{name}.png")
    if drive.cameras:
        configs = [_camera_config(camera) for camera in drive.cameras]
        write_json(folder / "camera_config" / f"{name}.json", configs)


def _camera_config(camera: Camera) -> dict[str, Any]:
    k = camera.intrinsic
    return {
        "camera_internal": {
            "fx": float(k[0, 0]),
            "fy": float(k[1, 1]),
            "cx": float(k[0, 2]),
            "cy": float(k[1, 2]),
        },
        "width": camera.width_px,
        "height": camera.height_px,
        "camera_external": [float(value) for value in inverse(camera.ego_from_camera).flat],
        "rowMajor": True,
    }


def _read_scene(folder: Path) -> ExportBoxes:
    found = FoundBoxes()
    for path in sorted((folder / _RESULT).glob("*.json")):
        frame = frame_of_name(path.stem, str(path))
        content = JsonValue.of_file(path)
        # An export of Xtreme1 lists the results of several sources; what is uploaded can be one.
        for result in content.elements() if isinstance(content.value, list) else (content,):
            objects = result.optional("objects")
            for entry in objects.elements() if objects else ():
                if entry.member("type").value in ("3D_BOX", "3D"):
                    _add(found, entry, frame)
    return found.boxes()


def _add(found: FoundBoxes, entry: JsonValue, frame: int) -> None:
    contour = entry.member("contour")
    size, center, angles = (
        contour.member(name).numbers("x", "y", "z") for name in ("size3D", "center3D", "rotation3D")
    )
    # The tool drops a class name that its ontology has not, and keeps it as that of the model.
    names = [entry.optional(name) for name in ("className", "modelClass")]
    name = next((known for known in names if known and known.value != ""), None) or entry.member("className")
    tracks = [entry.optional(key) for key in ("trackId", "trackName")]
    track = next((known.identifier() for known in tracks if known and known.value != ""), None)
    others = {"score": entry.optional("modelConfidence"), "num_points": contour.optional("pointN")}
    numbers = {key: value.number() for key, value in others.items() if value}
    found.add(frame, track, name.text(), [*center, *size, angles[2]], numbers)


FORMAT = ExportFormat("xtreme1", write, read, frozenset({SCORE, TRACK, POINTS}))
