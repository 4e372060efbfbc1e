"""KITTI's raw recordings (`<date>/<drive>_sync`).

Files are numbered by frame; a frame is kept when it has a sweep, a time stamp and, where the drive has poses, an
oxts record. Everything left out is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from upvl_cli.datasets.kitti import twist
from upvl_cli.datasets.kitti.calibration import Calibration, read_calibration
from upvl_cli.datasets.kitti.drive import KittiDrive, complete_frames
from upvl_cli.datasets.kitti.oxts import OxtsRecord, world_from_ego
from upvl_cli.datasets.kitti.pictures import (
    CAMERAS,
    Picture,
    calibrated_cameras,
    picture_files,
    pictures_of_frames,
)
from upvl_cli.datasets.kitti.timestamps import read_timestamps, times_of_frames
from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.numbered_files import numbered_files
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Camera, Frame


def open_raw(folder: Path) -> KittiDrive:
    """Return the drive of a folder with `velodyne_points`.

    Raises:
        BadInput: No frame is complete, or a file is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    calibration = read_calibration(folder.parent)
    imu = calibration.ego_from_imu
    records = numbered_files(folder / "oxts/data", (".txt",)) if imu is not None else {}
    sweep_folder = _data(folder / "velodyne_points")
    sweeps = numbered_files(sweep_folder, (".bin",))
    times_path = folder / "velodyne_points/timestamps.txt"
    times = sweep_times(times_path, sweeps)
    needed = {"oxts record": records} if records else {}
    frames = complete_frames(sweeps, times, needed, skipped, sweep_folder, times_path)
    files = picture_files({name: _data(folder / name) for name in CAMERAS})
    cameras, pictures, _ = read_pictures(folder, files, calibration, frames, skipped)
    images = (picture.path for of_camera in pictures.values() for picture in of_camera.values())
    time_files = (path for path in folder.glob("*/timestamps.txt") if path.parent.name != "oxts")
    return KittiDrive(
        name=folder.name,
        folder=folder,
        layout="raw",
        calibration=calibration,
        frames=frames,
        sweeps={frame.index: sweeps[frame.index] for frame in frames},
        turn_s=twist.turn_s(times),
        cameras=cameras,
        pictures=pictures,
        world_from_ego=_poses(records, [frame.index for frame in frames], imu),
        skipped=dict(skipped),
        files=tuple(sorted({*calibration.files, *time_files, *records.values(), *sweeps.values(), *images})),
    )


def _data(folder: Path) -> Path:
    """Return where the files of a sensor lie: in `data`, or without it as some tools write them."""
    return folder / "data" if (folder / "data").is_dir() else folder


def sweep_times(path: Path, sweeps: Mapping[int, Path]) -> dict[int, int]:
    """Return the time of each frame number by a `timestamps.txt`; raises `BadInput` where it is missing."""
    if not path.is_file():
        raise BadInput(f"{path} is missing; without the time of each sweep no speed is known: copy it again")
    return times_of_frames(read_timestamps(path), sweeps, path)


def read_pictures(
    folder: Path,
    files: Mapping[str, Mapping[int, Path]],
    calibration: Calibration,
    frames: Sequence[Frame],
    skipped: Counter[str],
) -> tuple[tuple[Camera, ...], dict[str, dict[int, Picture]], list[Path]]:
    """Return the cameras, their pictures at their own times, and the files of these times.

    Args:
        folder: The folder with `<camera>/timestamps.txt`.
        files: The pictures of each camera, by frame number.
        calibration: The calibration.
        frames: The frames of the drive.
        skipped: What is left out, by reason.
    """
    cameras = calibrated_cameras(files, calibration.cameras, skipped)
    pictures, time_files = {}, []
    for camera in cameras:
        paths, path = files[camera.name], folder / camera.name / "timestamps.txt"
        times = None
        if path.is_file():
            times = times_of_frames(read_timestamps(path), paths, path)
            time_files.append(path)
        else:
            reason = f"{camera.name} pictures without timestamps.txt, taken at the times of the sweeps"
            skipped[reason] = len(paths)
        pictures[camera.name] = pictures_of_frames(camera.name, paths, frames, times, skipped)
    return cameras, pictures, time_files


def _poses(records: Mapping[int, Path], numbers: list[int], ego_from_imu: Array | None) -> Array | None:
    if ego_from_imu is None or not records:
        return None
    texts = {
        number: OxtsRecord(read_text(records[number]), f"{records[number]}, line 1")
        for number in (min(records), *numbers)
    }
    return world_from_ego(texts[min(records)], [texts[number] for number in numbers], ego_from_imu)
