"""KITTI's raw recordings (`<date>/<drive>_sync`), read in place.

Ego axes are those of the LiDAR. Its files are numbered by frame; a frame is kept when it has a sweep, a
time stamp and, where the drive has poses, an oxts record. Everything left out is counted.
"""

from __future__ import annotations

import difflib
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.datasets.kitti_calibration import Calibration, read_calibration
from upvl_cli.datasets.kitti_files import check_picture, numbered_files, read_picture, read_sweep
from upvl_cli.datasets.kitti_oxts import world_from_ego
from upvl_cli.datasets.kitti_text import read_times
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Frame, Image, Points

_LIDAR_HEIGHT_M = 1.73  # the Velodyne above the road: Geiger et al., IJRR 2013, figure 3
_CAMERAS = ("image_00", "image_01", "image_02", "image_03")
_NAME = re.compile(r"[A-Za-z0-9._-]+")
_EXPECTED = "<root>/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data/0000000000.bin"


@dataclass(frozen=True)
class Picture:
    """Where the picture of a frame lies, and when it was taken."""

    path: Path
    time_ns: int


@dataclass(frozen=True)
class KittiDrive:
    """One drive of KITTI's raw data.

    It has all that a `Drive` has, and also:

    Attributes:
        folder: The folder of the drive.
        calibration: What the calibration files of its day give.
        sweeps: The LiDAR file of each of `frames`.
        pictures: The pictures of each camera, by frame.
    """

    name: str
    folder: Path
    calibration: Calibration
    frames: tuple[Frame, ...]
    sweeps: Mapping[int, Path]
    cameras: tuple[Camera, ...]
    pictures: Mapping[str, Mapping[int, Picture]]
    world_from_ego: Array | None
    skipped: Mapping[str, int]
    files: tuple[Path, ...]
    ground_z_m: float = -_LIDAR_HEIGHT_M

    def points(self, frame: int) -> Points:
        """The sweep of a frame; raises `BadInput` where its file is damaged."""
        if frame not in self.sweeps:
            known = f"it has {len(self.sweeps)} between {min(self.sweeps)} and {max(self.sweeps)}"
            raise BadInput(f"{self.name} has no frame {frame}; {known}")
        return read_sweep(self.sweeps[frame])

    def image(self, frame: int, camera: str) -> Image | None:
        """The picture of a camera such as `image_02`; raises `BadInput` where its file is damaged."""
        found = next((known for known in self.cameras if known.name == camera), None)
        if found is None:
            known = ", ".join(self.pictures) or "none"
            raise BadInput(f"{self.name} has no camera {camera!r}; it has {known}")
        picture = self.pictures[camera].get(frame)
        if picture is None:
            return None
        return Image(read_picture(picture.path, found.width_px, found.height_px), picture.time_ns)


class Kitti:
    """The drives below a folder; the folder of one day or of one drive will do as well."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders = _drive_folders(root)

    @property
    def segments(self) -> tuple[str, ...]:
        """Folder names of the drives, sorted."""
        return tuple(sorted(self._folders))

    def open(self, segment: str) -> KittiDrive:
        """The drive of that name; raises `BadInput` where the name is unknown or the drive damaged."""
        if segment not in self._folders:
            raise BadInput(f"{self._root} has no segment {segment!r}; {_suggestion(segment, self.segments)}")
        return _open_drive(self._folders[segment])


def _drive_folders(root: Path) -> dict[str, Path]:
    root = Path(os.path.abspath(root))  # a root `.` has no name; links stay as they are
    folders: dict[str, Path] = {}
    for pattern in ("velodyne_points", "*/velodyne_points", "*/*/velodyne_points"):
        for folder in sorted(sweeps.parent for sweeps in root.glob(pattern)):
            if not _NAME.fullmatch(folder.name):
                raise BadInput(
                    f"{folder}: rename it; a drive's name holds letters, digits, '.', '_', '-' only"
                )
            if folder.name in folders:
                raise BadInput(
                    f"{folder} has the name of {folders[folder.name]}; keep one of them below {root}"
                )
            folders[folder.name] = folder
    if not folders:
        raise BadInput(f"{root} has no drive of KITTI's raw data; expected {_EXPECTED}")
    return folders


def _suggestion(segment: str, segments: Sequence[str]) -> str:
    close = difflib.get_close_matches(segment, segments)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    return hint + (
        f"it has {', '.join(segments)}" if len(segments) <= 10 else f"it has {len(segments)} segments"
    )


def _open_drive(folder: Path) -> KittiDrive:
    skipped: Counter[str] = Counter()
    calibration = read_calibration(folder.parent)
    imu = calibration.ego_from_imu
    records = numbered_files(folder / "oxts/data", ".txt") if imu is not None else {}
    sweeps, frames = _frames(folder, records, skipped)
    numbers = [frame.index for frame in frames]
    cameras, pictures = _cameras(folder, calibration, numbers, skipped)
    images = (picture.path for of_camera in pictures.values() for picture in of_camera.values())
    times = (path for path in folder.glob("*/timestamps.txt") if path.parent.name != "oxts")
    return KittiDrive(
        name=folder.name,
        folder=folder,
        calibration=calibration,
        frames=frames,
        sweeps={number: sweeps[number] for number in numbers},
        cameras=cameras,
        pictures=pictures,
        world_from_ego=world_from_ego(records, numbers, imu) if imu is not None and records else None,
        skipped=dict(skipped),
        files=tuple(sorted({*calibration.files, *times, *records.values(), *sweeps.values(), *images})),
    )


def _frames(
    folder: Path, records: Mapping[int, Path], skipped: Counter[str]
) -> tuple[dict[int, Path], tuple[Frame, ...]]:
    """All sweeps, and the frames that are complete."""
    sweeps = numbered_files(folder / "velodyne_points/data", ".bin")
    times_path = folder / "velodyne_points/timestamps.txt"
    if not times_path.is_file():
        raise BadInput(
            f"{times_path} is missing; without the time of each sweep no speed is known: copy it again"
        )
    times = read_times(times_path)
    frames = []
    for number in sorted({*sweeps, *times}):
        if number not in sweeps:
            skipped["no sweep"] += 1
        elif number not in times:
            skipped["sweep without time stamp"] += 1
        elif records and number not in records:
            skipped["sweep without oxts record"] += 1
        else:
            frames.append(Frame(number, times[number]))
    if not frames:
        reasons = ", ".join(f"{count} {reason}" for reason, count in skipped.items()) or "no .bin"
        raise BadInput(f"{folder} has no complete frame ({reasons}); expected {_EXPECTED} and its time stamp")
    for before, after in zip(frames, frames[1:], strict=False):
        if not after.time_ns > before.time_ns:
            where = f"{times_path}, line {after.index + 1}"
            raise BadInput(
                f"{where}: frame {after.index} is not later than frame {before.index}; mend the line"
            )
    return sweeps, tuple(frames)


def _cameras(
    folder: Path, calibration: Calibration, numbers: Sequence[int], skipped: Counter[str]
) -> tuple[tuple[Camera, ...], dict[str, dict[int, Picture]]]:
    """The cameras that have pictures and a calibration, and the pictures of the frames of these numbers."""
    cameras, pictures = [], {}
    for name in _CAMERAS:
        paths = numbered_files(folder / name / "data", ".png")
        camera = calibration.cameras.get(name)
        if paths and camera is None:
            skipped[f"{name} picture without calibration"] += len(paths)
        elif paths and camera is not None:
            check_picture(paths[min(paths)], camera.width_px, camera.height_px)
            cameras.append(camera)
            pictures[name] = _pictures(folder / name, paths, numbers, skipped)
    return tuple(cameras), pictures


def _pictures(
    folder: Path, paths: Mapping[int, Path], numbers: Sequence[int], skipped: Counter[str]
) -> dict[int, Picture]:
    times_path = folder / "timestamps.txt"
    times = read_times(times_path) if times_path.is_file() else {}
    pictures = {}
    for number in numbers:
        if number not in paths:
            skipped[f"no {folder.name} picture"] += 1
        elif number not in times:
            skipped[f"{folder.name} picture without time stamp"] += 1
        else:
            pictures[number] = Picture(paths[number], times[number])
    return pictures
