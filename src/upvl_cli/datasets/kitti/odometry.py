"""KITTI's odometry sequences (`sequences/00`), as SemanticKITTI has them too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti import twist
from upvl_cli.datasets.kitti.drive import KittiDrive, complete_frames
from upvl_cli.datasets.kitti.pictures import SHORT_CAMERAS
from upvl_cli.datasets.kitti.sequence import SequenceFiles, nominal_times, read_cameras, sequence_drive
from upvl_cli.datasets.kitti.timestamps import (
    TIMES_ASSUMED,
    lines_of_frames,
    read_lines,
    read_seconds,
    times_of_frames,
)
from upvl_cli.datasets.shared.numbered_files import numbered_files
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.datasets.shared.poses import check_pose
from upvl_cli.types import Array


def open_odometry(folder: Path) -> KittiDrive:
    """Return the drive of a sequence's folder.

    Its sweeps are motion-compensated by who made the set; the poses are those of camera 0.

    Raises:
        BadInput: No frame is complete, or a file is not what it has to be.
    """
    skipped: Counter[str] = Counter()
    sweeps = numbered_files(folder / "velodyne", (".bin",))
    pictures, calibration = read_cameras(
        {name: folder / name for name in SHORT_CAMERAS}, folder / "calib.txt"
    )
    times_path, poses_path = folder / "times.txt", _poses_path(folder)
    if times_path.is_file():
        times = times_of_frames(read_seconds(times_path), sweeps, times_path)
    else:
        times = nominal_times(sweeps)
        skipped[TIMES_ASSUMED] = len(sweeps)
    rect_from_ego = calibration.rect_from_ego
    poses: Mapping[int, tuple[str, str]] = {}
    if poses_path and rect_from_ego is not None:
        poses = _pose_lines(poses_path, sweeps)
    needed = {"pose": poses} if poses else {}
    frames = complete_frames(sweeps, times, needed, skipped, folder / "velodyne", times_path)
    others = tuple(path for path in (times_path, poses_path) if path and path.is_file())
    files = SequenceFiles(folder.name, folder, "odometry", sweeps, pictures, calibration, others)
    world_from_ego = None
    if poses and rect_from_ego is not None:
        world_from_ego = _world_from_ego([poses[frame.index] for frame in frames], rect_from_ego)
    return sequence_drive(
        files, frames, world_from_ego, skipped, turn_s=twist.turn_s(times), is_compensated=True
    )


def _poses_path(folder: Path) -> Path | None:
    """Return the file of poses: beside the sequences (KITTI), or in the sequence (SemanticKITTI)."""
    candidates = (folder.parent.parent / "poses" / f"{folder.name}.txt", folder / "poses.txt")
    return next((path for path in candidates if path.is_file()), None)


def _pose_lines(path: Path, sweeps: Mapping[int, Path]) -> dict[int, tuple[str, str]]:
    """Return text and place of the line of each frame number."""
    lines = read_lines(path)
    line_of = lines_of_frames(len(lines), sweeps, path)
    return {
        frame: (lines[line], f"{path}, line {line + 1}")
        for frame, line in line_of.items()
        if lines[line].strip()
    }


def _world_from_ego(lines: list[tuple[str, str]], rect_from_ego: Array) -> Array:
    """Return (T, 4, 4) poses of the LiDAR, in the axes of the LiDAR at the pose of camera 0 that is the origin."""
    rows = [numbers(text, 12, where).reshape(3, 4) for text, where in lines]
    poses = np.stack([check_pose(row, where) for row, (_, where) in zip(rows, lines, strict=True)])
    return np.asarray(np.linalg.inv(rect_from_ego) @ poses @ rect_from_ego)
