"""One KITTI drive: which of its frames are complete, and what they hold.

Ego axes are those of the LiDAR. Files are numbered by frame; a frame is kept when it has a sweep, a time
stamp and, where the drive has poses, an oxts record. Everything left out is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti import twist as kitti_twist
from upvl_cli.datasets.kitti.calibration import Calibration, read_calibration
from upvl_cli.datasets.kitti.files import check_picture, numbered_files, read_picture, read_sweep
from upvl_cli.datasets.kitti.oxts import world_from_ego
from upvl_cli.datasets.kitti.text import read_times
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Frame, Image, Points

EXPECTED = "<root>/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data/0000000000.bin"

_LIDAR_HEIGHT_M = 1.73  # the Velodyne above the road: Geiger et al., IJRR 2013, figure 3
# The car around its LiDAR, with the rack whose tips return up to 1.5 m to each side (seen in drive 0001):
# what is measured in there moves as the car does, and is the car.
_CAR_X_M, _CAR_Y_M = (-2.3, 3.0), (-1.6, 1.6)
_LEAST_STEP_NS = 1_000_000  # no LiDAR makes a thousand sweeps a second; speeds are divided by this
_CAMERAS = ("image_00", "image_01", "image_02", "image_03")


@dataclass(frozen=True)
class Picture:
    """Where the picture of a frame lies, and when it was taken."""

    path: Path
    time_ns: int


@dataclass(frozen=True, eq=False)
class KittiDrive:
    """One drive of KITTI's raw data.

    It has all that a `Drive` has, and also:

    Attributes:
        folder: The folder of the drive.
        calibration: What the calibration files of its day give.
        sweeps: The LiDAR file of each of `frames`.
        pictures: The pictures of each camera, by frame.
        turn_s: Seconds that the LiDAR takes to turn once; 0 where unknown.
    """

    name: str
    folder: Path
    calibration: Calibration
    frames: tuple[Frame, ...]
    sweeps: Mapping[int, Path]
    turn_s: float
    cameras: tuple[Camera, ...]
    pictures: Mapping[str, Mapping[int, Picture]]
    world_from_ego: Array | None
    skipped: Mapping[str, int]
    files: tuple[Path, ...]
    ground_z_m: float = -_LIDAR_HEIGHT_M

    def points(self, frame: int) -> Points:
        """Return the sweep of a frame without the car itself, motion-compensated where the drive has poses.

        Raises:
            BadInput: There is no such frame, or its file is damaged.
        """
        if frame not in self.sweeps:
            known = f"it has {len(self.sweeps)} between {min(self.sweeps)} and {max(self.sweeps)}"
            raise BadInput(f"{self.name} has no frame {frame}; {known}")
        values = _without_car(read_sweep(self.sweeps[frame]))
        xyz_ego_m, total = np.ascontiguousarray(values[:, :3]), len(values)
        offset_s = kitti_twist.offsets_s(xyz_ego_m, turn_s=self.turn_s)
        return Points(
            xyz_ego_m=self._untwist(frame, xyz_ego_m, offset_s),
            intensity=np.ascontiguousarray(values[:, 3]),
            elongation=np.zeros(total, np.float32),
            sensor=np.zeros(total, np.uint8),
            time_offset_ns=offset_s * 1e9,
        )

    def untwist(self, frame: int, xyz_ego_m: Array) -> Array:
        """Return places that the turning LiDAR saw, as from where the car stood at the frame's time.

        Args:
            frame: Index of the frame.
            xyz_ego_m: (n, 3) places; without poses they stay what they are.
        """
        return self._untwist(frame, xyz_ego_m, kitti_twist.offsets_s(xyz_ego_m, turn_s=self.turn_s))

    def _untwist(self, frame: int, xyz_ego_m: Array, offset_s: Array) -> Array:
        if self.world_from_ego is None:
            return xyz_ego_m
        step = [known.index for known in self.frames].index(frame)
        near = slice(max(step - 1, 0), step + 2)
        time_ns = np.array([known.time_ns for known in self.frames[near]])
        twists = kitti_twist.twists(time_ns, self.world_from_ego[near])
        return kitti_twist.untwist(xyz_ego_m, twists[step - near.start], offset_s)

    def image(self, frame: int, camera: str) -> Image | None:
        """Return the picture of a camera such as `image_02`, or None where it is missing.

        Raises:
            BadInput: There is no such camera, or the file is damaged.
        """
        found = next((known for known in self.cameras if known.name == camera), None)
        if found is None:
            raise BadInput(
                f"{self.name} has no camera {camera!r}; it has {', '.join(self.pictures) or 'none'}"
            )
        picture = self.pictures[camera].get(frame)
        if picture is None:
            return None
        return Image(read_picture(picture.path, found.width_px, found.height_px), picture.time_ns)


def open_drive(folder: Path) -> KittiDrive:
    """Return the drive of a folder.

    Raises:
        BadInput: No frame is complete, or a file is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    calibration = read_calibration(folder.parent)
    imu = calibration.ego_from_imu
    records = numbered_files(folder / "oxts/data", ".txt") if imu is not None else {}
    sweeps = numbered_files(folder / "velodyne_points/data", ".bin")
    times = _sweep_times(folder)
    frames = _frames(folder, sweeps, times, records, skipped)
    numbers = [frame.index for frame in frames]
    cameras, pictures = _cameras(folder, calibration, numbers, skipped)
    images = (picture.path for of_camera in pictures.values() for picture in of_camera.values())
    time_files = (path for path in folder.glob("*/timestamps.txt") if path.parent.name != "oxts")
    return KittiDrive(
        name=folder.name,
        folder=folder,
        calibration=calibration,
        frames=frames,
        sweeps={number: sweeps[number] for number in numbers},
        turn_s=kitti_twist.turn_s(times),
        cameras=cameras,
        pictures=pictures,
        world_from_ego=world_from_ego(records, numbers, imu) if imu is not None and records else None,
        skipped=dict(skipped),
        files=tuple(sorted({*calibration.files, *time_files, *records.values(), *sweeps.values(), *images})),
    )


def _sweep_times(folder: Path) -> dict[int, int]:
    path = folder / "velodyne_points/timestamps.txt"
    if not path.is_file():
        raise BadInput(f"{path} is missing; without the time of each sweep no speed is known: copy it again")
    return read_times(path)


def _frames(
    folder: Path,
    sweeps: Mapping[int, Path],
    times: Mapping[int, int],
    records: Mapping[int, Path],
    skipped: Counter[str],
) -> tuple[Frame, ...]:
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
        raise BadInput(f"{folder} has no complete frame ({reasons}); expected {EXPECTED} and its time stamp")
    for before, after in zip(frames, frames[1:], strict=False):
        later_ns = after.time_ns - before.time_ns
        if later_ns < _LEAST_STEP_NS:
            where = f"{folder}/velodyne_points/timestamps.txt, line {after.index + 1}"
            how = f"only {later_ns} ns" if later_ns > 0 else "not"
            raise BadInput(
                f"{where}: frame {after.index} is {how} later than frame {before.index}; mend the line"
            )
    return tuple(frames)


def _cameras(
    folder: Path, calibration: Calibration, numbers: Sequence[int], skipped: Counter[str]
) -> tuple[tuple[Camera, ...], dict[str, dict[int, Picture]]]:
    """Return the cameras that have pictures and a calibration, and their pictures of the frames of these numbers."""
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


def _without_car(values: Array) -> Array:
    """Return the points of a sweep, (n, 4), that do not lie on the car that carries the LiDAR."""
    x_m, y_m = values[:, 0], values[:, 1]
    along = (x_m > _CAR_X_M[0]) & (x_m < _CAR_X_M[1])
    on_car = along & (y_m > _CAR_Y_M[0]) & (y_m < _CAR_Y_M[1])
    return np.asarray(values.take(np.flatnonzero(~on_car), axis=0))
