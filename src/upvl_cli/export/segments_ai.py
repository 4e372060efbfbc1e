"""Segments.ai: `<drive>.label.json` of a point cloud cuboid sequence, `<drive>.sample.json`, `task_attributes.json`.

Cuboids are in world coordinates, those of the ego poses in the sample (docs of Segments.ai, label and sample
formats). The tool keeps places in 32-bit floats, so the place of the first frame is taken as the origin, as its docs
advise. Boxes of upvl stand upright in the axes of their frame: `rotation` has that turn in full, for datasets where
3D rotation is on; `yaw` is its shadow, for those where it is off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.json_value import JsonValue
from upvl_cli.export.rotations import (
    heading_of_nose,
    heading_of_shadow,
    matrix_of_quat_xyzw,
    quat_xyzw_of_matrix,
)
from upvl_cli.export.sweeps import write_picture, write_points_pcd
from upvl_cli.export.tool_files import (
    NUMBERS,
    FoundBoxes,
    boxes_of_frame,
    frame_name,
    numbers_beside,
    write_json,
    xyz_object,
)
from upvl_cli.geometry.se3 import apply, from_yaw, inverse
from upvl_cli.types import Array, Camera

_LABEL, _SAMPLE, _TASK = ".label.json", ".sample.json", "task_attributes.json"
_VERSION = "0.2"
_CUBOIDS = ("cuboid", "cuboid-sync")


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write label and sample of each drive, and the categories of all."""
    categories: dict[str, int] = {}
    for drive in drives:
        for name in np.unique(drive.boxes.class_name):
            categories.setdefault(str(name), len(categories) + 1)
        poses = _local_poses(drive)
        frames = [
            _label_frame(boxes_of_frame(drive, frame.index), poses[place], categories)
            | {"timestamp": str(frame.time_ns)}
            for place, frame in enumerate(drive.frames)
        ]
        write_json(folder / f"{drive.name}{_LABEL}", {"format_version": _VERSION, "frames": frames})
        sample = [_sample_frame(drive, place, poses[place]) for place in range(len(drive.frames))]
        write_json(folder / f"{drive.name}{_SAMPLE}", {"frames": sample})
        for frame in drive.frames if options.with_data else ():
            write_points_pcd(drive, frame.index, folder / _points_path(drive, frame.index))
            for camera in drive.cameras:
                write_picture(drive, frame.index, camera, folder / _picture_path(drive, frame.index, camera))
    write_json(folder / _TASK, _task_attributes(categories), indent=1)


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of each label that bears the name of a drive, and of releases that hold such labels."""
    found = {}
    task = folder / _TASK
    for name, drive in drives.items():
        path = folder / f"{name}{_LABEL}"
        if path.is_file():
            if not task.is_file():
                raise BadInput(f"{task} is missing; expected the names of the categories of {path.name}")
            found[name] = _read_label(JsonValue.of_file(path), _categories(JsonValue.of_file(task)), drive)
    return found or _read_releases(folder, drives)


def _local_poses(drive: ExportDrive) -> Array:
    """Return (T, 4, 4) poses in world axes whose origin is the place of the first frame."""
    poses = drive.world_from_ego.copy()
    if len(poses):
        poses[:, :3, 3] -= drive.world_from_ego[0, :3, 3]
    return poses


def _label_frame(boxes: ExportBoxes, pose: Array, categories: Mapping[str, int]) -> dict[str, Any]:
    annotations = []
    for i in range(len(boxes)):
        turn = pose[:3, :3] @ from_yaw(boxes.heading_rad[i], np.zeros(3))[:3, :3]
        quaternion = map(float, quat_xyzw_of_matrix(turn))
        annotations.append(
            {
                "id": i + 1,
                "category_id": categories[str(boxes.class_name[i])],
                "type": "cuboid",
                "position": xyz_object(apply(pose, boxes.center_m[i : i + 1])[0]),
                "dimensions": xyz_object(boxes.size_lwh_m[i]),
                "yaw": heading_of_nose(turn[:, 0]),
                "rotation": dict(zip(("qx", "qy", "qz", "qw"), quaternion, strict=True)),
                "track_id": int(boxes.track_id[i]),
                "is_keyframe": True,
                "attributes": numbers_beside(boxes, i),
            }
        )
    return {"format_version": _VERSION, "annotations": annotations}


def _points_path(drive: ExportDrive, frame: int) -> str:
    return f"{drive.name}/points/{frame_name(frame)}.pcd"


def _picture_path(drive: ExportDrive, frame: int, camera: Camera) -> str:
    return f"{drive.name}/{camera.name}/{frame_name(frame)}.png"


def _sample_frame(drive: ExportDrive, place: int, pose: Array) -> dict[str, Any]:
    """Return a frame of the sample; its files are named by their paths, to be replaced by URLs once they are online."""
    frame = drive.frames[place]
    images = [
        {"name": camera.name, "url": _picture_path(drive, frame.index, camera), "row": 0, "col": column}
        | _calibration(camera)
        for column, camera in enumerate(drive.cameras)
    ]
    return {
        "name": frame_name(frame.index),
        "timestamp": str(frame.time_ns),
        "pcd": {"url": _points_path(drive, frame.index), "type": "pcd"},
        "ego_pose": {"position": xyz_object(pose[:3, 3]), "heading": _quaternion(pose)},
        "images": images,
    }


def _calibration(camera: Camera) -> dict[str, Any]:
    names = (
        ("k1", "k2", "k3", "k4") if camera.distortion_model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    )
    lens = dict(zip(names, map(float, camera.distortion), strict=True))
    model = "fisheye" if camera.distortion_model == "fisheye" else "brown-conrady"
    pose = camera.ego_from_camera
    return {
        "intrinsics": {"intrinsic_matrix": camera.intrinsic.tolist()},
        "extrinsics": {"translation": xyz_object(pose[:3, 3]), "rotation": _quaternion(pose)},
        "distortion": {"model": model, "coefficients": lens},
        "camera_convention": "OpenCV",
    }


def _quaternion(pose: Array) -> dict[str, float]:
    values = map(float, quat_xyzw_of_matrix(pose[:3, :3]))
    return dict(zip(("qx", "qy", "qz", "qw"), values, strict=True))


def _task_attributes(categories: Mapping[str, int]) -> dict[str, Any]:
    """Return the configuration of the dataset: without it the tool drops attributes."""
    attributes = [{"name": name, "input_type": "number"} for name in NUMBERS]
    entries = [{"id": number, "name": name, "attributes": attributes} for name, number in categories.items()]
    return {"format_version": "0.1", "categories": entries}


def _categories(task: JsonValue) -> dict[int, str]:
    entries = task.member("categories").elements()
    return {entry.member("id").integer(): entry.member("name").text() for entry in entries}


def _read_releases(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of release files: the samples that bear the names of drives, their first labels."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        release = JsonValue.of_file(path)
        if not isinstance(release.value, dict) or "dataset" not in release.value:
            continue
        dataset = release.member("dataset")
        categories = _categories(dataset.member("task_attributes"))
        for sample in dataset.member("samples").elements():
            name = sample.member("name").text()
            labels = sample.optional("labels")
            first = next((label for _, label in labels.members()), None) if labels else None
            if name in drives and first is not None:
                found[name] = _read_label(first, categories, drives[name])
    return found


def _read_label(label: JsonValue, categories: Mapping[int, str], drive: ExportDrive) -> ExportBoxes:
    content = label.optional("attributes") or label  # as the SDK gives it, or its attributes alone
    frames = list(content.member("frames").elements())
    if len(frames) != len(drive.frames):
        raise BadInput(
            f"{content.where} has {len(frames)} frames; drive {drive.name} has {len(drive.frames)}"
        )
    poses, found = _local_poses(drive), FoundBoxes()
    for place, frame in enumerate(frames):
        annotations = frame.optional("annotations")
        for entry in annotations.elements() if annotations else ():
            kind = entry.optional("type")
            if kind and kind.value not in _CUBOIDS:
                continue
            number = entry.member("category_id").integer()
            if number not in categories:
                raise BadInput(f"{entry.where} is of category {number}, which {_TASK} does not list")
            row = _row(entry, poses[place])
            track, attributes = entry.optional("track_id"), entry.optional("attributes")
            said = {name: attributes.optional(name) for name in NUMBERS} if attributes else {}
            numbers = {name: value.number() for name, value in said.items() if value and value.value != ""}
            found.add(
                drive.frames[place].index,
                track.identifier() if track else None,
                categories[number],
                row,
                numbers,
            )
    return found.boxes()


def _row(entry: JsonValue, pose: Array) -> list[float]:
    """Return a cuboid as place, size and heading in ego axes."""
    center = np.array([entry.member("position").numbers("x", "y", "z")])
    size = entry.member("dimensions").numbers("x", "y", "z")
    turn = entry.optional("rotation")
    if turn:
        rotation = matrix_of_quat_xyzw(turn.numbers("qx", "qy", "qz", "qw"), turn.where)
        heading = heading_of_nose(pose[:3, :3].T @ rotation[:, 0])
    else:
        heading = heading_of_shadow(pose, entry.member("yaw").number())
    return [*apply(inverse(pose), center)[0], *size, heading]


FORMAT = ExportFormat("segments-ai", write, read)
