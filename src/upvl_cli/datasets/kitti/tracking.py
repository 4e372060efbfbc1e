"""KITTI's tracking sequences (`training/velodyne/0000`), with calibration and inertial records of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from upvl_cli.datasets.kitti import twist
from upvl_cli.datasets.kitti.drive import KittiDrive, complete_frames
from upvl_cli.datasets.kitti.oxts import OxtsRecord, world_from_ego
from upvl_cli.datasets.kitti.pictures import CAMERAS
from upvl_cli.datasets.kitti.sequence import SequenceFiles, nominal_times, read_cameras, sequence_drive
from upvl_cli.datasets.kitti.timestamps import TIMES_ASSUMED, lines_of_frames, read_lines
from upvl_cli.datasets.shared.numbered_files import numbered_files


def open_tracking(folder: Path, name: str) -> KittiDrive:
    """Return the drive of a folder of sweeps.

    Args:
        folder: The sweeps of the sequence, for example `training/velodyne/0000`.
        name: The name of the drive.

    Raises:
        BadInput: No frame is complete, or a file is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    split, sequence = folder.parent.parent, folder.name
    sweeps = numbered_files(folder, (".bin",))
    camera_folders = {camera: split / camera / sequence for camera in CAMERAS}
    pictures, calibration = read_cameras(camera_folders, split / "calib" / f"{sequence}.txt")
    oxts = split / "oxts" / f"{sequence}.txt"
    imu = calibration.ego_from_imu
    records = _records(oxts, sweeps) if imu is not None and oxts.is_file() else {}
    known = {*range(max(sweeps, default=-1) + 1), *records}
    needed = {"oxts record": records} if records else {}
    times = nominal_times(known)
    frames = complete_frames(sweeps, times, needed, skipped, folder, folder)
    skipped[TIMES_ASSUMED] = len(frames)
    poses = None
    if records and imu is not None:
        poses = world_from_ego(records[min(records)], [records[frame.index] for frame in frames], imu)
    others = (oxts,) if records else ()
    files = SequenceFiles(name, folder, "tracking", sweeps, pictures, calibration, others)
    return sequence_drive(files, frames, poses, skipped, turn_s=twist.turn_s(times), is_compensated=False)


def _records(path: Path, sweeps: Mapping[int, Path]) -> dict[int, OxtsRecord]:
    lines = read_lines(path)
    line_of = lines_of_frames(len(lines), sweeps, path)
    return {
        frame: OxtsRecord(lines[line], f"{path}, line {line + 1}")
        for frame, line in line_of.items()
        if lines[line].strip()
    }
