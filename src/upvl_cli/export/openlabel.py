"""ASAM OpenLABEL 1.0: `<drive>.openlabel.json`, cuboids of 10 values (place, quaternion x y z w, size) in ego axes.

Names follow the specification and the schema of version 1.0.0 (ASAM e.V., 2021, sections 7.13.1 and 8): transforms
as row-major 4 x 4 matrices with X_dst = M X_src, camera axes x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.json_value import JsonValue
from upvl_cli.export.rotations import heading_of_nose, matrix_of_quat_xyzw, quat_xyzw_of_heading
from upvl_cli.export.tool_files import VELOCITY, FoundBoxes, boxes_of_frame, write_json
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Camera, Ints

_EGO, _WORLD, _SHAPE = "ego", "world", "shape"
_ENDINGS = (".openlabel.json", ".json")  # a tool may shorten the name


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one file a drive."""
    for drive in drives:
        write_json(folder / f"{drive.name}{_ENDINGS[0]}", {"openlabel": _content(drive)})


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of each file that bears the name of a drive."""
    found = {}
    for name, drive in drives.items():
        paths = [folder / f"{name}{ending}" for ending in _ENDINGS if f"{name}{ending}" != "upvl.json"]
        path = next((path for path in paths if path.is_file()), None)
        if path is not None:
            found[name] = _read_drive(JsonValue.of_file(path).member("openlabel"), drive)
    return found


def _content(drive: ExportDrive) -> dict[str, Any]:
    content: dict[str, Any] = {
        "metadata": {"schema_version": "1.0.0", "name": drive.name, "annotator": "upvl"},
        "coordinate_systems": _coordinate_systems(drive.cameras),
        "streams": {camera.name: _stream(camera) for camera in drive.cameras},
        "objects": {str(boxes.track_id[0]): _object(boxes) for boxes in _tracks(drive.boxes)},
        "frames": {
            str(frame.index): _frame(drive, place, frame.time_ns) for place, frame in enumerate(drive.frames)
        },
        "frame_intervals": _intervals(np.array([frame.index for frame in drive.frames], dtype=np.int64)),
    }
    return content


def _tracks(boxes: ExportBoxes) -> Iterator[ExportBoxes]:
    """Yield the boxes of each track, by ascending frame."""
    ordered = boxes[np.argsort(boxes.track_id, kind="stable")]
    starts = np.flatnonzero(np.diff(ordered.track_id, prepend=-(2**62)))
    for start, end in pairwise([*starts, len(ordered)]):
        yield ordered[start:end]


def _coordinate_systems(cameras: tuple[Camera, ...]) -> dict[str, Any]:
    sensors = {
        camera.name: {
            "type": "sensor_cs",
            "parent": _EGO,
            "children": [],
            "pose_wrt_parent": _matrix(camera.ego_from_camera),
        }
        for camera in cameras
    }
    return {
        _WORLD: {"type": "scene_cs", "parent": "", "children": [_EGO]},
        _EGO: {"type": "local_cs", "parent": _WORLD, "children": list(sensors)},
    } | sensors


def _stream(camera: Camera) -> dict[str, Any]:
    """Return a camera as a stream; its lens is that of OpenCV in either schema."""
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    lens = [float(value) for value in camera.distortion]
    if camera.distortion_model == "fisheye":
        k = camera.intrinsic
        intrinsics = {
            "center_x_px": float(k[0, 2]),
            "center_y_px": float(k[1, 2]),
            "focal_length_x": float(k[0, 0]),
            "focal_length_y": float(k[1, 1]),
            "lens_coeffs": lens,
        }
        return {"type": "camera", "stream_properties": {"intrinsics_fisheye": intrinsics | size}}
    matrix = [float(value) for value in np.column_stack([camera.intrinsic, np.zeros(3)]).flat]
    pinhole = {"camera_matrix": matrix, "distortion_coeffs": lens}
    return {"type": "camera", "stream_properties": {"intrinsics_pinhole": pinhole | size}}


def _object(boxes: ExportBoxes) -> dict[str, Any]:
    """Return what an object has once; its class is that of its first box, as a track has one class."""
    intervals = _intervals(boxes.frame)
    name = str(boxes.class_name[0])
    return {
        "name": f"{name} {boxes.track_id[0]}",
        "type": name,
        "coordinate_system": _EGO,
        "frame_intervals": intervals,
        "object_data_pointers": {_SHAPE: {"type": "cuboid", "frame_intervals": intervals}},
    }


def _frame(drive: ExportDrive, place: int, time_ns: int) -> dict[str, Any]:
    boxes = boxes_of_frame(drive, drive.frames[place].index)
    pose = {
        "src": _EGO,
        "dst": _WORLD,
        "transform_src_to_dst": _matrix(drive.world_from_ego[place]),
    }
    return {
        "frame_properties": {
            # As text: a double would round it to some hundred nanoseconds.
            "timestamp": f"{time_ns // 10**9}.{time_ns % 10**9:09d}",
            "transforms": {f"{_EGO}_to_{_WORLD}": pose},
        },
        "objects": {
            str(track): {"object_data": {"cuboid": [_cuboid(boxes, i)]}}
            for i, track in enumerate(boxes.track_id)
        },
    }


def _cuboid(boxes: ExportBoxes, i: int) -> dict[str, Any]:
    values = [boxes.center_m[i], quat_xyzw_of_heading(boxes.heading_rad[i]), boxes.size_lwh_m[i]]
    attributes: dict[str, list[dict[str, Any]]] = {"num": [], "text": []}
    # The class again: an object has one type, and a correction can be of one frame.
    attributes["text"].append({"name": "class", "val": str(boxes.class_name[i])})
    if np.isfinite(boxes.score[i]):
        attributes["num"].append({"name": "score", "val": float(boxes.score[i])})
    if boxes.num_points[i] >= 0:
        attributes["num"].append({"name": "num_points", "val": int(boxes.num_points[i])})
    if np.isfinite(boxes.velocity_mps[i]).all():
        velocity = [float(value) for value in boxes.velocity_mps[i]]
        attributes["vec"] = [{"name": "velocity_mps", "val": velocity, "coordinate_system": _EGO}]
    return {
        "name": _SHAPE,
        "coordinate_system": _EGO,
        "val": [float(value) for value in np.concatenate(values)],
        "attributes": attributes,
    }


def _matrix(dst_from_src: Array) -> dict[str, list[float]]:
    return {"matrix4x4": [float(value) for value in np.asarray(dst_from_src).flat]}


def _intervals(frames: Ints) -> list[dict[str, int]]:
    """Return runs of frame numbers that follow each other, both ends included."""
    numbers = np.unique(frames)
    starts = np.flatnonzero(np.diff(numbers, prepend=-(10**9)) > 1)
    ends = np.append(starts[1:], len(numbers)) - 1
    return [
        {"frame_start": int(numbers[start]), "frame_end": int(numbers[end])}
        for start, end in zip(starts, ends, strict=True)
    ]


def _read_drive(content: JsonValue, drive: ExportDrive) -> ExportBoxes:
    objects = content.optional("objects")
    known = dict(objects.members()) if objects else {}
    loose = [known[uid] for uid in known if _cuboids(known[uid])]
    if loose:
        raise BadInput(f"{loose[0].where} has a cuboid that is of no frame; expected cuboids within frames")
    found, frames = FoundBoxes(), content.optional("frames")
    for number, frame in frames.members() if frames else ():
        if not (number.isascii() and number.isdigit() and len(number) < 16):
            raise BadInput(f"{frame.where} is no frame; expected its number")
        present = frame.optional("objects")
        for uid, entry in present.members() if present else ():
            for cuboid in _cuboids(entry):
                _add(found, cuboid, int(number), uid, known.get(uid), drive)
    return found.boxes()


def _cuboids(entry: JsonValue) -> list[JsonValue]:
    data = entry.optional("object_data")
    cuboids = data.optional("cuboid") if data else None
    return [cuboid for cuboid in cuboids.elements() if cuboid.optional("val")] if cuboids else []


def _add(
    found: FoundBoxes,
    cuboid: JsonValue,
    frame: int,
    uid: str,
    described: JsonValue | None,
    drive: ExportDrive,
) -> None:
    values = cuboid.member("val").list_of_numbers((9, 10))
    turn = values[3:-3]
    rotation = matrix_of_quat_xyzw(turn, cuboid.where) if len(turn) == 4 else _matrix_of_euler(turn)
    center, nose = np.array(values[:3]), rotation[:, 0]
    system = cuboid.optional("coordinate_system") or (described and described.optional("coordinate_system"))
    axes = system.text() if system else _EGO
    if axes == _WORLD:
        ego_from_world = inverse(drive.world_from_ego[drive.places_of([frame])[0]])
        center, nose = apply(ego_from_world, center[None])[0], ego_from_world[:3, :3] @ nose
    elif axes != _EGO:
        raise BadInput(f"{cuboid.where} is in the axes {axes[:40]!r}; expected {_EGO!r} or {_WORLD!r}")
    name, others = _attributes(cuboid)
    if not name:
        if described is None:
            raise BadInput(
                f"{cuboid.where} is of an object that the file does not describe; expected its type"
            )
        name = described.member("type").text()
    found.add(frame, uid, name, [*center, *values[-3:], heading_of_nose(nose)], others)


def _attributes(cuboid: JsonValue) -> tuple[str, dict[str, float]]:
    """Return the class, empty where it is not said again, and the numbers of a cuboid."""
    attributes = cuboid.optional("attributes")
    if attributes is None:
        return "", {}
    of_kind = {
        kind: {entry.member("name").text(): entry.member("val") for entry in entries.elements()}
        for kind, entries in attributes.members()
    }
    others = {name: value.number() for name, value in of_kind.get("num", {}).items()}
    if velocity := of_kind.get("vec", {}).get("velocity_mps"):
        others |= dict(zip(VELOCITY, velocity.list_of_numbers((3,)), strict=True))
    name = of_kind.get("text", {}).get("class")
    return (name.text() if name else ""), others


def _matrix_of_euler(angles_rad: list[float]) -> Array:
    """Return the rotation of Euler angles about x, y and z, in the specification's default sequence ZYX."""
    from scipy.spatial.transform import Rotation

    matrix: Array = Rotation.from_euler("ZYX", angles_rad[::-1]).as_matrix()
    return matrix


FORMAT = ExportFormat("openlabel", write, read)
