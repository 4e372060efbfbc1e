"""SUSTechPOINTS: `<drive>/label/<frame>.json`, a list of boxes, in the scene folders of that tool.

With data also `lidar/<frame>.pcd`, `camera/<name>/<frame>.png` and `calib/camera/<name>.json`. Boxes are in the axes
of the points: centre, sizes along the box's x, y and z, angles of three.js (docs of the tool, data-format.md); the yaw
is 0 along x, counter-clockwise seen from above.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import TRACK, ExportFormat, ExportOptions
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
from upvl_cli.types import Array

# The types of the tool's own list (public/js/obj_cfg.js); it shows any other one as Unknown, by its name.
CLASSES = {
    "vehicle": "Car",
    "pedestrian": "Pedestrian",
    "cyclist": "BicycleRider",
    "other": "Misc",
    "unknown": "Unknown",
    "car": "Car",
    "van": "Van",
    "bus": "Bus",
    "truck": "Truck",
    "tram": "Tram",
    "bicycle": "Bicycle",
    "motorcycle": "Motorcycle",
    "person": "Pedestrian",
}
_LABELS = "label"


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one scene a drive."""
    for drive in drives:
        own = folder / drive.name
        for frame in drive.frames:
            boxes, name = boxes_of_frame(drive, frame.index), frame_name(frame.index)
            write_json(own / _LABELS / f"{name}.json", [_box(boxes, i) for i in range(len(boxes))])
            if options.with_data:
                write_points_pcd(drive, frame.index, own / "lidar" / f"{name}.pcd")
                for camera in drive.cameras:
                    write_picture(drive, frame.index, camera, own / "camera" / camera.name / f"{name}.png")
        (own / _LABELS).mkdir(parents=True, exist_ok=True)
        for camera in drive.cameras if options.with_data else ():
            calibration = {
                "extrinsic": [float(value) for value in inverse(camera.ego_from_camera).flat],
                "intrinsic": [float(value) for value in camera.intrinsic.flat],
            }
            write_json(own / "calib" / "camera" / f"{camera.name}.json", calibration)


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all scenes that bear the names of drives."""
    return {name: _read_scene(own / _LABELS) for name, own, _ in drive_folders(folder, drives, _LABELS)}


def _box(boxes: ExportBoxes, i: int) -> dict[str, Any]:
    return {
        "obj_id": str(boxes.track_id[i]),
        "obj_type": str(boxes.class_name[i]),
        "psr": {
            "position": xyz_object(boxes.center_m[i]),
            "scale": xyz_object(boxes.size_lwh_m[i]),
            "rotation": xyz_object(np.array([0.0, 0.0, boxes.heading_rad[i]])),
        },
    }


def _read_scene(folder: Path) -> ExportBoxes:
    if not folder.is_dir():
        raise BadInput(f"{folder} is no folder; expected the label files of a scene")
    found = FoundBoxes()
    for path in sorted(folder.glob("*.json")):
        frame = frame_of_name(path.stem, str(path))
        content = JsonValue.of_file(path)
        boxes = content.member("objs") if isinstance(content.value, dict) else content  # newer servers: objs
        for entry in boxes.elements():
            psr = entry.member("psr")
            place, size, angles = (
                psr.member(name).numbers("x", "y", "z") for name in ("position", "scale", "rotation")
            )
            track = entry.optional("obj_id")
            number = None if track is None or track.value == "" else track.identifier()
            name = entry.member("obj_type").text()
            found.add(frame, number, name, [*place, *size, _heading(np.array(angles))], {})
    return found.boxes()


def _heading(angles_rad: Array) -> float:
    """Return the heading of a box that the tool turned: R = Rx Ry Rz, whose first column is the nose."""
    cx, sx = np.cos(angles_rad[0]), np.sin(angles_rad[0])
    _, sy = np.cos(angles_rad[1]), np.sin(angles_rad[1])
    cz, sz = np.cos(angles_rad[2]), np.sin(angles_rad[2])
    return float(np.arctan2(cx * sz + sx * sy * cz, np.cos(angles_rad[1]) * cz))


FORMAT = ExportFormat("sustechpoints", write, read, frozenset({TRACK}), CLASSES)
