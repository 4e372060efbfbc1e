"""Argoverse 2: a folder a drive with `annotations.feather` in ego axes, the poses of the car and its cameras.

Columns as in the sensor data set (av2, `structures/cuboid.py`), and further ones, which av2 passes over: `score`, as
in its files of detections, and the velocity along the ego axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather

from upvl_cli.datasets.argoverse2.calibration import INTRINSICS, MOUNTS
from upvl_cli.datasets.argoverse2.drive import PICTURES, POSES, SWEEPS
from upvl_cli.datasets.argoverse2.poses import QUATERNION, TRANSLATION
from upvl_cli.datasets.shared.arrow import floats_or_nan, read_feather, texts, values
from upvl_cli.datasets.shared.poses import quaternion_rotation, rigid
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses, boxes_of_rows, track_numbers
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.frame_times import frames_at_ns
from upvl_cli.export.sweeps import write_picture
from upvl_cli.export.world_axes import quaternions_wxyz
from upvl_cli.geometry.se3 import from_yaw, yaw_of
from upvl_cli.types import Array

CLASSES = {
    "vehicle": "REGULAR_VEHICLE",
    "pedestrian": "PEDESTRIAN",
    "cyclist": "BICYCLIST",
    "car": "REGULAR_VEHICLE",
    "van": "LARGE_VEHICLE",
    "truck": "TRUCK",
    "bus": "BUS",
    "school bus": "SCHOOL_BUS",
    "tram": "RAILED_VEHICLE",
    "trailer": "VEHICULAR_TRAILER",
    "motorcycle": "MOTORCYCLE",
    "motorcyclist": "MOTORCYCLIST",
    "bicycle": "BICYCLE",
    "stroller": "STROLLER",
    "wheelchair": "WHEELCHAIR",
    "traffic sign": "SIGN",
    "stop sign": "STOP_SIGN",
    "traffic cone": "CONSTRUCTION_CONE",
    "bollard": "BOLLARD",
    "dog": "DOG",
    "animal": "ANIMAL",
}
_ANNOTATIONS = "annotations.feather"
_SIZE = ("length_m", "width_m", "height_m")
_VELOCITY = ("velocity_x_mps", "velocity_y_mps", "velocity_z_mps")
_MAX_INTENSITY = 255


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write a log a drive."""
    for drive in drives:
        log = folder / drive.name
        log.mkdir()
        boxes = drive.boxes
        columns = {
            "timestamp_ns": drive.times_ns[drive.places],
            "track_uuid": [str(track) for track in boxes.track_id],
            "category": boxes.class_name.tolist(),
            **dict(zip(_SIZE, boxes.size_lwh_m.T, strict=True)),
            **_pose_columns(from_yaw(boxes.heading_rad, boxes.center_m)),
            "num_interior_pts": boxes.num_points,
            "score": boxes.score,
            **dict(zip(_VELOCITY, boxes.velocity_mps.T, strict=True)),
        }
        _write(log / _ANNOTATIONS, columns, texts={"track_uuid", "category"})
        _write(log / POSES, {"timestamp_ns": drive.times_ns, **_pose_columns(drive.world_from_ego)})
        _write_cameras(drive, log, losses)
        if options.with_data and drive.source is not None:
            _write_data(drive, log)


def _pose_columns(poses: Array) -> dict[str, Array]:
    """Return the quaternion and the translation of (n, 4, 4) poses as columns."""
    rotation, place = quaternions_wxyz(poses), poses[:, :3, 3]
    return dict(zip((*QUATERNION, *TRANSLATION), np.column_stack([rotation, place]).T, strict=True))


def _write_cameras(drive: ExportDrive, log: Path, losses: Losses) -> None:
    cameras = drive.cameras
    if not cameras:
        return
    losses[
        "cameras with a lens: Argoverse 2 has k1 to k3, and its tools take pictures as those of a pinhole"
    ] += sum(bool(camera.distortion.any()) for camera in cameras)
    (log / MOUNTS).parent.mkdir()
    names = [camera.name for camera in cameras]
    mounts = np.array([camera.ego_from_camera for camera in cameras])
    _write(log / MOUNTS, {"sensor_name": names, **_pose_columns(mounts)}, texts={"sensor_name"})
    pinhole = np.array([camera.intrinsic[[0, 1, 0, 1], [0, 1, 2, 2]] for camera in cameras])
    lens = np.array(
        [
            camera.distortion[[0, 1, 4]] if camera.distortion_model == "brown" else np.zeros(3)
            for camera in cameras
        ]
    )
    columns = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), pinhole.T, strict=True))
    columns |= dict(zip(("k1", "k2", "k3"), lens.T, strict=True))
    sizes = {
        "height_px": np.array([camera.height_px for camera in cameras], dtype=np.int64),
        "width_px": np.array([camera.width_px for camera in cameras], dtype=np.int64),
    }
    _write(log / INTRINSICS, {"sensor_name": names, **columns, **sizes}, texts={"sensor_name"})


def _write_data(drive: ExportDrive, log: Path) -> None:
    """Write the sweeps and pictures, each named by its time."""
    assert drive.source is not None
    (log / SWEEPS).mkdir(parents=True)
    for frame in drive.frames:
        points = drive.source.points(frame.index)
        x, y, z = points.xyz_ego_m.T
        columns = {
            "x": x,
            "y": y,
            "z": z,
            "intensity": np.rint(points.intensity * _MAX_INTENSITY).clip(0, _MAX_INTENSITY).astype(np.uint8),
            "laser_number": np.zeros(len(points), np.uint8),
            "offset_ns": points.time_offset_ns.astype(np.int32),
        }
        _write(log / SWEEPS / f"{frame.time_ns}.feather", columns)
        for camera in drive.cameras:
            if camera.name.replace("_", "").replace("-", "").isalnum():  # a name becomes a folder
                write_picture(
                    drive, frame.index, camera, log / PICTURES / camera.name / f"{frame.time_ns}.jpg"
                )


def _write(
    path: Path, columns: Mapping[str, Array | list[str]], texts: frozenset[str] | set[str] = frozenset()
) -> None:
    arrays = {
        name: pa.array(column, pa.string()) if name in texts else pa.array(np.ascontiguousarray(column))
        for name, column in columns.items()
    }
    pyarrow.feather.write_feather(pa.table(arrays), str(path), compression="zstd")


def read(folder: Path, drives: Mapping[str, ExportDrive]) -> dict[str, ExportBoxes]:
    """Return the boxes of each log that bears the name of a drive."""
    paths = {name: folder / name / _ANNOTATIONS for name in drives}
    return {name: _read_log(path, drives[name]) for name, path in paths.items() if path.is_file()}


def _read_log(path: Path, drive: ExportDrive) -> ExportBoxes:
    needed = ("timestamp_ns", "track_uuid", "category", *_SIZE, *QUATERNION, *TRANSLATION)
    table = read_feather(path, needed, ("num_interior_pts", "score", *_VELOCITY))

    def stacked(names: tuple[str, ...]) -> Array:
        return np.column_stack([values(table, name, "float64", path) for name in names])

    def optional(name: str, missing: float) -> Array:
        found = (
            floats_or_nan(table, name, path) if name in table.column_names else np.full(len(table), np.nan)
        )
        return np.where(np.isfinite(found), found, missing)

    rotation = quaternion_rotation(stacked(QUATERNION), f"{path}: a rotation")
    poses = rigid(rotation, stacked(TRANSLATION))
    return boxes_of_rows(
        np.column_stack([poses[:, :3, 3], stacked(_SIZE), yaw_of(poses)]),
        frame=frames_at_ns(drive, values(table, "timestamp_ns", "int64", path), path),
        track_id=track_numbers(texts(table, "track_uuid", path)),
        class_name=np.array(texts(table, "category", path), dtype=str),
        score=optional("score", 1.0),
        velocity_mps=np.column_stack([optional(name, np.nan) for name in _VELOCITY]),
        num_points=optional("num_interior_pts", -1).clip(-1, 2**31).astype(np.int64),
    )


FORMAT = ExportFormat("argoverse2", write, read, classes=CLASSES, fixed_classes=True)
