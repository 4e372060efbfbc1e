"""A folder of point files, with poses and times from where its owner has them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from upvl_cli.datasets.recordings.axes import ego_from_axes
from upvl_cli.datasets.recordings.camera_file import FolderCamera, match_pictures, read_cameras
from upvl_cli.datasets.recordings.pose_file import PoseTable, read_matrix, read_poses
from upvl_cli.datasets.recordings.pose_track import NO_POSE, PoseTrack
from upvl_cli.datasets.recordings.scan_drive import ScanDrive, ScanFile
from upvl_cli.datasets.recordings.stamps import read_time_file, times_in_names
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.numbered_files import describe_files
from upvl_cli.datasets.shared.times import check_frames
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Frame

NO_TIME = "sweeps without a time"
SUFFIXES = (".pcd", ".ply", ".npz", ".npy", ".bin")
_MORE_SUFFIXES = (*SUFFIXES, ".gz")


@dataclass(frozen=True)
class ScanOptions:
    """What the owner of a folder says about it.

    Attributes:
        poses: Pose file.
        times: File of one stamp a line.
        rate_hz: Sweeps a second, where nothing tells their times.
        axes: Where x, y and z of the points lead; see `ego_from_axes`.
        mount: File with the pose of the LiDAR in the axes whose poses are given.
        cameras: TOML file of cameras.
    """

    poses: Path | None = None
    times: Path | None = None
    rate_hz: float | None = None
    axes: str = "flu"
    mount: Path | None = None
    cameras: Path | None = None


def point_files(folder: Path) -> list[Path]:
    """Return the files of points of a folder in the order of their numbers: those of its most frequent kind."""
    try:
        found = [
            path for path in folder.iterdir() if path.suffix.lower() in _MORE_SUFFIXES and path.is_file()
        ]
    except OSError as error:
        raise unreadable(folder, error) from None
    kinds = Counter(path.suffix.lower() for path in found)
    if not kinds:
        return []
    kind = min(kinds, key=lambda suffix: (-kinds[suffix], suffix))
    return sorted(
        (path for path in found if path.suffix.lower() == kind), key=lambda path: natural_key(path.name)
    )


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a key under which `2.pcd` stands before `10.pcd`."""
    parts = re.split(r"([0-9]+)", name)
    return [
        (1, int(part), part) if part.isascii() and part.isdigit() else (0, 0, part) for part in parts if part
    ]


def stem(path: Path) -> str:
    """Return the name without the suffixes of point files: `a.pcd.bin` is `a`, `15.6.pcd` is `15.6`."""
    name = path.name
    while Path(name).suffix.lower() in _MORE_SUFFIXES and Path(name).stem:
        name = Path(name).stem
    return name


def segment_name(source: Path) -> str:
    """Return a name for the drive of a file or folder."""
    name = source.resolve().name if source.is_dir() else source.resolve().stem
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip(".-") or "drive"


def open_scan_folder(source: Path, options: ScanOptions, cameras: Sequence[FolderCamera] = ()) -> ScanDrive:
    """Return the recording of a folder.

    Args:
        source: The folder, or one that holds a single folder of point files.
        options: What its owner says about it.
        cameras: Cameras that the folder's own layout tells of, in ego axes; those of the options replace them.

    Raises:
        BadInput: It holds no points, or sweeps, times and poses cannot be paired.
    """
    folder, paths = _folder(source)
    stems = [stem(path) for path in paths]
    table = read_poses(options.poses) if options.poses else None
    times, has_clock, note = _times(stems, options, table, folder)
    if has_clock and options.times is None:  # the order of the clock, where names may count otherwise
        order = sorted(range(len(paths)), key=lambda place: (times[place] is None, times[place] or 0))
        paths, stems = [paths[place] for place in order], [stems[place] for place in order]
        times = [times[place] for place in order]
    poses, pose_note = _poses(stems, times, has_clock, table, options)
    turn = ego_from_axes(options.axes)
    numbers = _frame_numbers(stems, folder)
    scans = []
    for place, path in enumerate(paths):
        time_ns, pose = times[place], None if poses is None else poses[place]
        reason = NO_TIME if time_ns is None else NO_POSE if poses is not None and pose is None else ""
        world_from_ego = None if pose is None else pose @ turn.T
        scans.append(ScanFile(path, numbers[place], time_ns or 0, world_from_ego, reason))
    kept = [scan for scan in scans if not scan.reason]
    if not kept:
        raise BadInput(
            f"{folder}: none of {len(scans)} sweeps has both a time and a pose; check {options.poses}"
        )
    check_frames([Frame(scan.frame, scan.time_ns) for scan in kept], options.times or folder)
    given = read_cameras(options.cameras, turn) if options.cameras else ()
    folder_cameras = tuple({known.camera.name: known for known in (*cameras, *given)}.values())
    by_frame = {
        scan.frame: (known, scan.time_ns) for scan, known in zip(scans, stems, strict=True) if not scan.reason
    }
    drive = ScanDrive(
        name=segment_name(source),
        scans=tuple(scans),
        ego_from_lidar=turn,
        cameras=tuple(known.camera for known in folder_cameras),
        picture_files={
            known.camera.name: match_pictures(known, by_frame, has_clock) for known in folder_cameras
        },
        more_files=tuple(
            path
            for path in (options.poses, options.times, options.mount, options.cameras)
            if path is not None
        ),
        notes=(f"{len(paths)} files like {paths[0].name}", note, pose_note),
    )
    return replace(drive, notes=tuple(filter(None, drive.notes)))


def _folder(source: Path) -> tuple[Path, list[Path]]:
    paths = point_files(source)
    if paths:
        return source, paths
    inner = [(path, point_files(path)) for path in sorted(source.iterdir()) if path.is_dir()]
    inner = [(path, files) for path, files in inner if files]
    if len(inner) == 1:
        return inner[0]
    found = (
        f"its folders {', '.join(path.name for path, _ in inner)[:100]} do: name one"
        if inner
        else (f"it has {describe_files(source)}")
    )
    raise BadInput(f"{source} holds no files of points ({', '.join(SUFFIXES)}); {found}")


def _frame_numbers(stems: Sequence[str], folder: Path) -> list[int]:
    """Return the numbers in the names where all are numbers, else their places."""
    if all(name.isascii() and name.isdigit() and len(name) <= 10 and int(name) < 2**31 for name in stems):
        numbers = [int(name) for name in stems]
        if len(set(numbers)) < len(numbers):
            twice = next(number for number, count in Counter(numbers).items() if count > 1)
            raise BadInput(f"{folder} has two files of number {twice}; remove one")
        if numbers == sorted(numbers):
            return numbers
    return list(range(len(stems)))


def _times(
    stems: Sequence[str], options: ScanOptions, table: PoseTable | None, folder: Path
) -> tuple[list[int | None], bool, str]:
    """Return the time of each sweep, whether they come from a clock, and from where."""
    if options.times is not None:
        return read_time_file(options.times, stems), True, f"times from {options.times}"
    if options.rate_hz is not None:
        numbers = _frame_numbers(stems, folder)
        return (
            [round(number * 1e9 / options.rate_hz) for number in numbers],
            False,
            (f"times by number, {options.rate_hz:g} sweeps a second"),
        )
    found = times_in_names(stems)
    if found is not None:
        return list(found), True, "times from the names of the files"
    if table is not None and table.times_ns is not None:
        if len(table.times_ns) == len(stems):
            return table.times_ns.tolist(), True, f"times from {options.poses}, by order"
        numbers = _frame_numbers(stems, folder)
        if all(name.isdigit() for name in stems) and max(numbers) < len(table.times_ns):
            return (
                [int(table.times_ns[number]) for number in numbers],
                True,
                f"times from {options.poses}, by number",
            )
    raise BadInput(
        f"{folder}: nothing tells the times of its {len(stems)} sweeps ({stems[0]} to {stems[-1]}); give a file of one "
        "stamp a line with --times, or the sweeps a second with --rate-hz"
    )


def _poses(
    stems: Sequence[str],
    times: Sequence[int | None],
    has_clock: bool,
    table: PoseTable | None,
    options: ScanOptions,
) -> tuple[list[Array | None] | None, str]:
    """Return world_from_lidar of each sweep, None where it has none; or None without a pose file."""
    if table is None:
        return None, "no poses: they will come from odometry"
    mount = read_matrix(options.mount) if options.mount else np.eye(4)
    poses = np.asarray(table.poses @ mount)
    source = f"poses from {options.poses} ({table.form})"
    if table.times_ns is not None and has_clock:
        track = PoseTrack.in_time_order(table.times_ns, poses)
        found = [None if time_ns is None else track.at(time_ns) for time_ns in times]
        if any(pose is not None for pose in found):
            return found, f"{source}, by time"
        known = [time_ns for time_ns in times if time_ns is not None]
        raise BadInput(
            f"{options.poses}: its poses are from {track.times_ns[0] / 1e9:.3f} s to "
            f"{track.times_ns[-1] / 1e9:.3f} s, and the sweeps from {min(known, default=0) / 1e9:.3f} s to "
            f"{max(known, default=0) / 1e9:.3f} s; expected one clock"
        )
    if len(poses) == len(stems):
        return list(poses), f"{source}, by order"
    numbers = [int(name) for name in stems if name.isascii() and name.isdigit()]
    if len(numbers) == len(stems) and max(numbers) < len(poses):
        return [poses[number] for number in numbers], f"{source}, by number"
    raise BadInput(
        f"{options.poses} has {len(poses)} poses for {len(stems)} sweeps ({stems[0]} to {stems[-1]}), and not both "
        "have times; expected one pose a sweep, or times in both"
    )
