"""What the object, tracking and odometry sets have alike: a drive from sweeps, pictures and one calibration file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.datasets.kitti.calibration import Calibration, read_benchmark_calibration
from upvl_cli.datasets.kitti.drive import KittiDrive, Layout
from upvl_cli.datasets.kitti.pictures import calibrated_cameras, picture_files, pictures_of_frames, sizes_px
from upvl_cli.datasets.kitti.timestamps import NOMINAL_STEP_NS
from upvl_cli.types import Array, Frame


@dataclass(frozen=True)
class SequenceFiles:
    """The files of one drive.

    Attributes:
        name: Name of the drive.
        folder: See `KittiDrive`.
        layout: Which set it is of.
        sweeps: The sweeps by frame number.
        pictures: The pictures of each camera that has some, by frame number.
        calibration: What its calibration file gives.
        others: Further files that make it what it is: times and poses.
    """

    name: str
    folder: Path
    layout: Layout
    sweeps: Mapping[int, Path]
    pictures: Mapping[str, Mapping[int, Path]]
    calibration: Calibration
    others: tuple[Path, ...] = ()


def read_cameras(
    folders: Mapping[str, Path], calibration_path: Path, only: Collection[int] | None = None
) -> tuple[dict[str, dict[int, Path]], Calibration]:
    """Return the pictures of each camera, and the calibration.

    Args:
        folders: The folder of each of the cameras 0 to 3.
        calibration_path: The file with their projections.
        only: The frame numbers of the drive, where its folders hold other drives too.
    """
    files = picture_files(folders)
    if only is not None:
        known = set(only)
        kept = {name: {n: path for n, path in paths.items() if n in known} for name, paths in files.items()}
        files = {name: paths for name, paths in kept.items() if paths}
    return files, read_benchmark_calibration(calibration_path, tuple(folders), sizes_px(files))


def sequence_drive(
    files: SequenceFiles,
    frames: Sequence[Frame],
    poses: Array | None,
    skipped: Counter[str],
    *,
    turn_s: float,
    is_compensated: bool,
    is_view_of_delft: bool = False,
) -> KittiDrive:
    """Return the drive of these files.

    Args:
        files: Its files.
        frames: Its complete frames.
        poses: (T, 4, 4) their poses, or None.
        skipped: What was left out, by reason.
        turn_s: Seconds that the LiDAR takes to turn once; 0 where unknown.
        is_compensated: Whether the sweeps hold points where they were at the frame's time.
        is_view_of_delft: See `KittiDrive`.
    """
    cameras = calibrated_cameras(files.pictures, files.calibration.cameras, skipped)
    pictures = {
        camera.name: pictures_of_frames(camera.name, files.pictures[camera.name], frames, None, skipped)
        for camera in cameras
    }
    images = (picture.path for of_camera in pictures.values() for picture in of_camera.values())
    return KittiDrive(
        name=files.name,
        folder=files.folder,
        layout=files.layout,
        calibration=files.calibration,
        frames=tuple(frames),
        sweeps={frame.index: files.sweeps[frame.index] for frame in frames},
        turn_s=turn_s,
        cameras=cameras,
        pictures=pictures,
        world_from_ego=poses,
        skipped=dict(skipped),
        files=tuple(sorted({*files.calibration.files, *files.others, *files.sweeps.values(), *images})),
        is_compensated=is_compensated,
        is_view_of_delft=is_view_of_delft,
    )


def nominal_times(numbers: Collection[int]) -> dict[int, int]:
    """Return the time of each frame number, ten a second from 0: where nobody wrote them down."""
    return {number: number * NOMINAL_STEP_NS for number in numbers}
