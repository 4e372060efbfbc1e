"""KITTI's object set (`training/velodyne`), which View-of-Delft shares.

Each frame has a calibration file of its own, and no frame has a time. KITTI's frames have nothing to do with each
other; those of View-of-Delft follow each other ten times a second and have poses.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti.drive import KittiDrive, complete_frames
from upvl_cli.datasets.kitti.pictures import SHORT_CAMERAS
from upvl_cli.datasets.kitti.sequence import SequenceFiles, nominal_times, read_cameras, sequence_drive
from upvl_cli.datasets.kitti.timestamps import NOMINAL_STEP_NS, TIMES_ASSUMED
from upvl_cli.datasets.shared.content import read_bytes, read_text
from upvl_cli.datasets.shared.numbered_files import numbered_files
from upvl_cli.datasets.shared.poses import check_pose
from upvl_cli.errors import BadInput, one_line
from upvl_cli.types import Array

# A recording of View-of-Delft ends where so many numbers are missing, or where the car would have to be faster.
_MAX_GAP = 10
_MAX_SPEED_MPS = 60.0
_MAX_JUMP_M = 3.0  # besides: the poses are those of the nearest message
_POSE = "odomToCamera"  # the pose of the camera in the axes of its recording, by its numbers and the devkit
_DIGITS = 6


@dataclass(frozen=True)
class ObjectRun:
    """Frames of an object set that make one drive.

    Attributes:
        split: The folder with `velodyne`, `calib` and so on.
        name: The name of the drive.
        sweeps: The sweeps by frame number.
    """

    split: Path
    name: str
    sweeps: Mapping[int, Path]


def find_runs(split: Path) -> list[ObjectRun]:
    """Return the drives of a folder with `velodyne`.

    With poses a drive is what follows on with one calibration; without, it is all frames of one calibration.
    """
    sweeps = numbered_files(split / "velodyne", (".bin",))
    calibrations = numbered_files(split / "calib", (".txt",))
    digest = {number: _digest(calibrations.get(number)) for number in sweeps}
    poses = numbered_files(split / "pose", (".json",))
    runs: list[list[int]] = []
    if poses:
        places = {number: _place(poses[number]) for number in sweeps if number in poses}
        for number in sweeps:
            if not runs or digest[number] != digest[runs[-1][-1]] or _is_cut(runs[-1][-1], number, places):
                runs.append([])
            runs[-1].append(number)
    else:
        groups: dict[bytes, list[int]] = {}
        for number in sweeps:
            groups.setdefault(digest[number], []).append(number)
        runs = list(groups.values())
    return [
        ObjectRun(
            split,
            split.name if len(runs) == 1 else f"{split.name}-{run[0]:0{_DIGITS}d}",
            {number: sweeps[number] for number in run},
        )
        for run in runs
    ]


def open_object(run: ObjectRun) -> KittiDrive:
    """Return the drive of a run of frames.

    Raises:
        BadInput: No frame is complete, or a file is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    first = min(run.sweeps)
    calibration_files = numbered_files(run.split / "calib", (".txt",))
    folders = {name: run.split / name for name in SHORT_CAMERAS}
    calibration_path = calibration_files.get(first, run.split / "calib" / f"{first:0{_DIGITS}d}.txt")
    pictures, calibration = read_cameras(folders, calibration_path, run.sweeps)
    pose_files = numbered_files(run.split / "pose", (".json",))
    has_poses = bool(pose_files) and calibration.rect_from_ego is not None
    needed = {"pose": pose_files} if has_poses else {}
    folder = run.split / "velodyne"
    frames = complete_frames(run.sweeps, nominal_times(run.sweeps), needed, skipped, folder, folder)
    skipped[TIMES_ASSUMED] = len(frames)
    poses = None
    paths: list[Path] = []
    if has_poses and calibration.rect_from_ego is not None:
        paths = [pose_files[frame.index] for frame in frames]
        poses = np.stack([_read_pose(path) for path in paths]) @ calibration.rect_from_ego
    others = [*paths, *(calibration_files[number] for number in run.sweeps if number in calibration_files)]
    files = SequenceFiles(run.name, run.split, "object", run.sweeps, pictures, calibration, tuple(others))
    return sequence_drive(
        files, frames, poses, skipped, turn_s=0.0, is_compensated=True, is_view_of_delft=bool(pose_files)
    )


def _digest(path: Path | None) -> bytes:
    return hashlib.sha256(read_bytes(path)).digest() if path else b""


def _place(path: Path) -> Array | None:
    """Return where the camera is; None where the file does not say it, which opening the drive tells."""
    try:
        return np.asarray(_read_pose(path)[:3, 3])
    except BadInput:
        return None


def _is_cut(before: int, after: int, places: Mapping[int, Array | None]) -> bool:
    """Return whether two frames that follow each other are of two recordings."""
    here, there = places.get(before), places.get(after)
    if after - before > _MAX_GAP or here is None or there is None:
        return after - before > _MAX_GAP
    seconds = (after - before) * NOMINAL_STEP_NS / 1e9
    return bool(np.linalg.norm(there - here) > _MAX_JUMP_M + _MAX_SPEED_MPS * seconds)


def _read_pose(path: Path) -> Array:
    """Return (4, 4) of one frame: a file holds one JSON object a line, or one in all."""
    try:
        parsed = [json.loads(line) for line in read_text(path).splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is no JSON ({one_line(error)}); copy it again") from None
    values = next((part[_POSE] for part in parsed if isinstance(part, dict) and _POSE in part), None)
    if not isinstance(values, list) or len(values) != 16 or not all(type(v) in (int, float) for v in values):
        raise BadInput(f"{path} has no {_POSE} of 16 numbers; copy it again")
    try:
        matrix = np.array(values, dtype=np.float64).reshape(4, 4)
    except OverflowError:
        raise BadInput(f"{path}: {_POSE} holds a number without end; copy it again") from None
    return check_pose(matrix, f"{path}: {_POSE}")
