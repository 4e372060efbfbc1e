"""Supervisely point clouds, which CVAT reads as "Sly Point Cloud Format 1.0", tracks included.

`<drive>/meta.json`, `<drive>/key_id_map.json`, `<drive>/ds0/ann/<frame>.pcd.json`, and with data
`<drive>/ds0/pointcloud/<frame>.pcd` and `<drive>/ds0/related_images/<frame>_pcd/<camera>.png`. Boxes are in the axes
of the points: centre, angles about x, y and z, sizes along them. `keyframe` of a figure is CVAT's own: with it, CVAT
makes one track of the figures of an object (sly_pointcloud_format/extractor.py of the datumaro that CVAT uses). CVAT
numbers tracks anew when it exports; `upvl_track` brings the number back where the label has such an attribute.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.cvat import CVAT_STEP
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.json_value import JsonValue
from upvl_cli.export.sweeps import write_picture, write_points_pcd
from upvl_cli.export.tool_files import (
    NUMBERS,
    FoundBoxes,
    boxes_of_frame,
    drive_folders,
    frame_name,
    frame_of_name,
    numbers_beside,
    write_json,
    xyz_object,
)
from upvl_cli.geometry.se3 import inverse
from upvl_cli.types import Camera

_META, _KEYS, _TRACK = "meta.json", "key_id_map.json", "upvl_track"
_DATA = Path("ds0")
_SPACE = uuid.UUID(
    "5c1f3a52-6e0b-5d0e-9c39-2f4d5a0f5c11"
)  # keys depend on names alone: same labels, same bytes


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one project a drive."""
    for drive in drives:
        own = folder / drive.name
        keys = _ProjectKeys(drive.name)
        for place, frame in enumerate(drive.frames):
            boxes = boxes_of_frame(drive, frame.index)
            name = frame_name(frame.index)
            write_json(own / _DATA / "ann" / f"{name}.pcd.json", keys.annotation(boxes, place))
            if options.with_data:
                _write_data(drive, frame.index, own / _DATA, name)
        write_json(own / _META, _meta(drive.boxes))
        write_json(own / _KEYS, keys.content)


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of all projects of drives."""
    return {name: _read_drive(own) for name, own, _ in drive_folders(folder, drives, _META)}


class _ProjectKeys:
    """The keys of a drive, and what they stand for."""

    def __init__(self, drive_name: str) -> None:
        """Start with none."""
        self.drive_name = drive_name
        self.content: dict[str, dict[str, int]] = {"tags": {}, "objects": {}, "figures": {}, "videos": {}}

    def key(self, kind: str, number: int) -> str:
        """Return the key of a thing, kept with its number."""
        key = str(uuid.uuid5(_SPACE, f"{self.drive_name}/{kind}/{number}"))
        self.content[kind][key] = number
        return key

    def annotation(self, boxes: ExportBoxes, place: int) -> dict[str, Any]:
        """Return the boxes of a frame."""
        objects, figures = [], []
        for i, track in enumerate(boxes.track_id):
            key = self.key("objects", int(track))
            numbers = {_TRACK: int(track)} | numbers_beside(boxes, i)
            tags = [
                {"key": str(uuid.uuid5(_SPACE, f"{key}/{place}/{name}")), "name": name, "value": value}
                for name, value in numbers.items()
            ]
            objects.append({"key": key, "classTitle": str(boxes.class_name[i]), "tags": tags})
            figures.append(
                {
                    "key": self.key("figures", len(self.content["figures"]) + 1),
                    "objectKey": key,
                    "geometryType": "cuboid_3d",
                    "geometry": {
                        "position": xyz_object(boxes.center_m[i]),
                        "rotation": xyz_object(np.array([0.0, 0.0, boxes.heading_rad[i]])),
                        "dimensions": xyz_object(boxes.size_lwh_m[i]),
                    },
                    "keyframe": True,
                }
            )
        key = self.key("videos", place)
        return {"description": "", "key": key, "tags": [], "objects": objects, "figures": figures}


def _meta(boxes: ExportBoxes) -> dict[str, Any]:
    """Return the classes and tags of a project."""
    classes = [
        {"id": place, "title": str(name), "color": "", "shape": "cuboid_3d", "geometry_config": {}}
        for place, name in enumerate(np.unique(boxes.class_name))
    ]
    tags = [
        {
            "id": place,
            "name": name,
            "value_type": "any_number",
            "color": "",
            "hotkey": "",
            "applicable_type": "objectsOnly",
            "classes": [],
        }
        for place, name in enumerate((_TRACK, *NUMBERS), start=1)
    ]
    return {"classes": classes, "tags": tags, "projectType": "point_clouds"}


def _write_data(drive: ExportDrive, frame: int, folder: Path, name: str) -> None:
    write_points_pcd(drive, frame, folder / "pointcloud" / f"{name}.pcd")
    pictures = folder / "related_images" / f"{name}_pcd"
    for camera in drive.cameras:
        path = pictures / f"{camera.name}.png"
        write_picture(drive, frame, camera, path)
        if path.exists():
            write_json(pictures / f"{camera.name}.png.json", _picture_meta(camera))


def _picture_meta(camera: Camera) -> dict[str, Any]:
    camera_from_ego = inverse(camera.ego_from_camera)
    matrices = {
        "extrinsicMatrix": [float(value) for value in camera_from_ego[:3].flat],
        "intrinsicMatrix": [float(value) for value in camera.intrinsic.flat],
    }
    return {"name": f"{camera.name}.png", "meta": {"sensorsData": matrices}}


def _read_drive(folder: Path) -> ExportBoxes:
    path = folder / _KEYS
    keys = JsonValue.of_file(path).optional("objects") if path.is_file() else None
    id_of = {key: number.identifier() for key, number in keys.members()} if keys else {}
    annotations = folder / _DATA / "ann"
    if not annotations.is_dir():
        raise BadInput(f"{annotations} is missing; copy the whole project")
    found = FoundBoxes()
    for path in sorted(annotations.rglob("*.json")):
        frame = frame_of_name(path.name.removesuffix(".json").removesuffix(".pcd"), str(path))
        content = JsonValue.of_file(path)
        objects = {entry.member("key").text(): entry for entry in content.member("objects").elements()}
        for figure in content.member("figures").elements():
            key = figure.member("objectKey").text()
            if key not in objects:
                raise BadInput(f"{figure.where} is of an object that {path.name} does not list")
            _add(found, figure, frame, objects[key], id_of.get(key, key))
    return found.boxes()


def _add(found: FoundBoxes, figure: JsonValue, frame: int, described: JsonValue, object_id: str) -> None:
    geometry = figure.member("geometry")
    kind = figure.optional("geometryType")
    if kind and kind.value != "cuboid_3d":
        return
    center, angles, size = (
        geometry.member(name).numbers("x", "y", "z") for name in ("position", "rotation", "dimensions")
    )
    tags = described.optional("tags")
    values = {tag.member("name").text(): tag.optional("value") for tag in tags.elements()} if tags else {}
    said = {name: value for name, value in values.items() if value is not None and value.value != ""}
    # A tool numbers its own objects: without our number they must not be taken for ours.
    track = said[_TRACK].identifier() if _TRACK in said else f"object {object_id}"
    numbers = {name: said[name].number() for name in NUMBERS if name in said}
    found.add(frame, track, described.member("classTitle").text(), [*center, *size, angles[2]], numbers)


FORMAT = ExportFormat("supervisely", write, read, tool_step=CVAT_STEP)
