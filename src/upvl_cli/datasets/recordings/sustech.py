"""SUSTechPOINTS: the folders of a scene of that annotation tool.

Poses of `ego_pose` are not read: how the LiDAR sits on the car of those poses stands in the tool's code, for its
makers' own car.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.datasets.recordings.axes import ego_from_axes
from upvl_cli.datasets.recordings.camera_file import FolderCamera, make_camera, picture_files
from upvl_cli.datasets.recordings.scan_drive import ScanDrive
from upvl_cli.datasets.recordings.scan_folder import ScanOptions, open_scan_folder, segment_name
from upvl_cli.datasets.shared.content import read_json
from upvl_cli.datasets.shared.pictures import picture_size
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.types import Array


def is_sustech(source: Path) -> bool:
    """Whether a folder is a scene: `lidar` beside `calib`, `label` or `camera`."""
    return (source / "lidar").is_dir() and any(
        (source / name).is_dir() for name in ("calib", "label", "camera")
    )


def open_sustech(source: Path, options: ScanOptions) -> ScanDrive:
    """Return the recording of a scene: `lidar/*.pcd`, `camera/<name>/*.jpg`, `calib/camera/<name>.json`.

    Args:
        source: The folder of the scene.
        options: What its owner says about it.

    Raises:
        BadInput: A calibration is damaged, or sweeps and times cannot be paired.
    """
    turn = ego_from_axes(options.axes)
    calibrations = sorted((source / "calib" / "camera").glob("*.json"))
    cameras = [
        _camera(path, source / "camera" / path.stem, turn)
        for path in calibrations
        if (source / "camera" / path.stem).is_dir()
    ]
    drive = open_scan_folder(source / "lidar", options, cameras)
    notes = [*drive.notes, f"cameras: {', '.join(known.camera.name for known in cameras) or 'none'}"]
    if (source / "ego_pose").is_dir() and options.poses is None:
        notes.append(
            "ego_pose is not read: how the LiDAR is mounted is not in the files; poses can be given by --poses"
        )
    return ScanDrive(
        name=segment_name(source),
        scans=drive.scans,
        ego_from_lidar=drive.ego_from_lidar,
        cameras=drive.cameras,
        picture_files=drive.picture_files,
        more_files=(*drive.more_files, *calibrations),
        notes=tuple(notes),
    )


def _camera(path: Path, folder: Path, ego_from_lidar: Array) -> FolderCamera:
    content = read_json(path)
    entries = content if isinstance(content, dict) else {}
    intrinsic = _matrix(entries.get("intrinsic"), 3, path, "intrinsic")
    camera_from_lidar = check_pose(
        _matrix(entries.get("extrinsic"), 4, path, "extrinsic"), str(path), max_m=MAX_ON_CAR_M
    )
    if not (intrinsic[0, 0] > 0 and intrinsic[1, 1] > 0 and np.array_equal(intrinsic[2], (0, 0, 1))):
        raise BadInput(f"{path}: intrinsic is no pinhole matrix; expected fx 0 cx, 0 fy cy, 0 0 1")
    pictures = picture_files(folder)
    size_px = picture_size(pictures[0], pictures[0])
    ego_from_camera = compose(ego_from_lidar, inverse(camera_from_lidar))
    return FolderCamera(make_camera(path.stem, size_px, intrinsic, (), ego_from_camera), pictures)


def _matrix(numbers: Any, size: int, path: Path, name: str) -> Array:
    rows = numbers if isinstance(numbers, list) else []
    flat = [cell for row in rows for cell in (row if isinstance(row, list) else [row])]
    is_number = all(isinstance(cell, int | float) and abs(cell) < 1e9 for cell in flat)
    if len(flat) != size * size or not is_number:
        raise BadInput(f"{path}: {name} is not {size} x {size} numbers; write the file again")
    return np.array(flat, dtype=np.float64).reshape(size, size)
