"""Cameras beside a folder of point files: a TOML file with a table a camera, and its folder of pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from upvl_cli.config.base import Config, setting
from upvl_cli.config.toml import parse, read_toml
from upvl_cli.datasets.recordings.scan_drive import PictureFile
from upvl_cli.datasets.recordings.stamps import times_in_names
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.poses import MAX_ON_CAR_M, check_pose
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.geometry.se3 import compose
from upvl_cli.types import Array, Camera

_SUFFIXES = (".jpg", ".jpeg", ".png")
_MOST_PX = 65535
_COEFFICIENTS = {"none": 0, "brown": 5, "fisheye": 4}


@dataclass(frozen=True)
class CameraEntry(Config):
    """One camera of a `cameras.toml`."""

    name: str = setting("Name of the camera")
    pictures: str = setting("Folder of its pictures, beside this file")
    width_px: int = setting("Width of its pictures", "px", ge=1, le=_MOST_PX)
    height_px: int = setting("Height of its pictures", "px", ge=1, le=_MOST_PX)
    fx_px: float = setting("Focal length along x", "px", gt=0)
    fy_px: float = setting("Focal length along y", "px", gt=0)
    cx_px: float = setting("Principal point, x; 0 is the centre of the first pixel", "px")
    cy_px: float = setting("Principal point, y", "px")
    distortion_model: str = setting("none, brown (k1 k2 p1 p2 k3) or fisheye (k1 k2 k3 k4)")
    distortion: tuple[float, ...] = setting("Its numbers")
    lidar_from_camera: tuple[float, ...] = setting(
        "4 x 4 pose of the camera in the axes of the points, row by row"
    )


@dataclass(frozen=True, eq=False)
class FolderCamera:
    """A calibrated camera and the pictures of its folder, in the order of their names."""

    camera: Camera
    pictures: tuple[Path, ...] = field(default=())


def read_cameras(path: Path, ego_from_lidar: Array) -> tuple[FolderCamera, ...]:
    """Return the cameras of a TOML file of tables `[[cameras]]`.

    Args:
        path: The file.
        ego_from_lidar: (4, 4) turn from the axes of the points.

    Raises:
        BadSetting: A key is missing, unknown or out of range.
        BadInput: A pose is no pose, or a folder of pictures cannot be read.
    """
    tables = read_toml(path)
    entries = tables.get("cameras")
    if set(tables) != {"cameras"} or not isinstance(entries, list) or not entries:
        raise BadSetting(
            f"{path} has {', '.join(tables)[:100] or 'nothing'}; expected tables [[cameras]] alone"
        )
    found = []
    for entry in entries:
        values = entry if isinstance(entry, dict) else {}
        values = {"distortion_model": "none", "distortion": [], **values}
        found.append(_camera(parse(CameraEntry, values, path), path, ego_from_lidar))
    names = [known.camera.name for known in found]
    if len(set(names)) < len(names):
        raise BadSetting(f"{path} has two cameras of one name: {', '.join(names)[:100]}")
    return tuple(found)


def _camera(entry: CameraEntry, path: Path, ego_from_lidar: Array) -> FolderCamera:
    where = f"{path}, camera {entry.name}"
    if len(entry.distortion) != _COEFFICIENTS.get(entry.distortion_model, -1):
        raise BadSetting(
            f"{where}: distortion_model is {entry.distortion_model!r} with {len(entry.distortion)} numbers; expected "
            "none with 0, brown with 5 or fisheye with 4"
        )
    if len(entry.lidar_from_camera) != 16:
        raise BadSetting(
            f"{where}: lidar_from_camera has {len(entry.lidar_from_camera)} numbers, expected 16"
        )
    mount = check_pose(
        np.array(entry.lidar_from_camera).reshape(4, 4), f"{where}: lidar_from_camera", max_m=MAX_ON_CAR_M
    )
    camera = make_camera(
        entry.name,
        (entry.width_px, entry.height_px),
        np.array([[entry.fx_px, 0, entry.cx_px], [0, entry.fy_px, entry.cy_px], [0, 0, 1]]),
        entry.distortion,
        compose(ego_from_lidar, mount),
        is_fisheye=entry.distortion_model == "fisheye",
    )
    return FolderCamera(camera, picture_files(path.parent / entry.pictures))


def make_camera(
    name: str, size_px: tuple[int, int], intrinsic: Array, distortion: Sequence[float], ego_from_camera: Array,
    *, is_fisheye: bool = False,
) -> Camera:  # fmt: skip
    """Return a camera; without distortion where there are no numbers of it."""
    return Camera(
        name=name,
        width_px=size_px[0],
        height_px=size_px[1],
        intrinsic=intrinsic,
        distortion=np.array(distortion if len(distortion) else np.zeros(4 if is_fisheye else 5)),
        ego_from_camera=ego_from_camera,
        distortion_model="fisheye" if is_fisheye else "brown",
    )


def picture_files(folder: Path) -> tuple[Path, ...]:
    """Return the JPEG and PNG files of a folder, by name; raises `BadInput` where it has none."""
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise unreadable(folder, error) from None
    if not found:
        raise BadInput(f"{folder} holds no pictures; expected {', '.join(_SUFFIXES)}")
    return tuple(found)


def match_pictures(
    known: FolderCamera, sweeps: Mapping[int, tuple[str, int]], has_clock: bool
) -> dict[int, PictureFile]:
    """Return the picture of each frame: of the same name, else the nearest in time, else the same place in order.

    Args:
        known: The camera.
        sweeps: Name without suffix, and time, of each frame.
        has_clock: Whether the times of the sweeps come from a clock, so that others can be compared with them.
    """
    stems = [path.stem for path in known.pictures]
    by_stem = dict(zip(stems, known.pictures, strict=True))
    times = times_in_names(stems) if has_clock else None
    same = {
        frame: PictureFile(by_stem[name], time_ns)
        for frame, (name, time_ns) in sweeps.items()
        if name in by_stem
    }
    if same:
        return same
    if times is not None:
        taken_ns = np.array(times)
        order = np.argsort(taken_ns)
        frame_ns = np.array([time_ns for _, time_ns in sweeps.values()])
        most_ns = np.median(np.diff(frame_ns)) / 2 if len(frame_ns) > 1 else 50e6
        found = {}
        for frame, (_, time_ns) in sweeps.items():
            near = int(order[np.abs(taken_ns[order] - time_ns).argmin()])
            if abs(int(taken_ns[near]) - time_ns) <= most_ns:
                found[frame] = PictureFile(known.pictures[near], int(taken_ns[near]))
        return found
    if len(stems) == len(sweeps):
        return {
            frame: PictureFile(path, time_ns)
            for (frame, (_, time_ns)), path in zip(sweeps.items(), known.pictures, strict=True)
        }
    raise BadInput(
        f"{known.pictures[0].parent} has {len(stems)} pictures ({stems[0]} to {stems[-1]}) for {len(sweeps)} sweeps; "
        "expected names as those of the sweeps, times in both, or as many"
    )
