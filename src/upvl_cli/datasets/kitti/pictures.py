"""The pictures of a drive: which belong to its sweeps, and when they were taken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from upvl_cli.datasets.shared.numbered_files import describe_files, has_files, numbered_files
from upvl_cli.datasets.shared.pictures import SUFFIXES, check_picture_size, picture_size
from upvl_cli.errors import BadInput
from upvl_cli.types import Camera, Frame

CAMERAS = ("image_00", "image_01", "image_02", "image_03")
SHORT_CAMERAS = ("image_0", "image_1", "image_2", "image_3")  # their names in the object and odometry sets


@dataclass(frozen=True)
class Picture:
    """Where the picture of a frame lies, and when it was taken."""

    path: Path
    time_ns: int


def picture_files(folders: Mapping[str, Path]) -> dict[str, dict[int, Path]]:
    """Return the pictures of each camera that has some, by frame number.

    Args:
        folders: The folder of each camera's pictures; one that is missing or empty is a camera without pictures.

    Raises:
        BadInput: A folder has files, and none of them is a picture with a frame number.
    """
    found = {name: numbered_files(folder, SUFFIXES) for name, folder in folders.items()}
    for name, folder in folders.items():
        if not found[name] and has_files(folder):
            raise BadInput(
                f"{describe_files(folder)}, none a picture with the number of a sweep; expected names like "
                "0000000000.png or .jpg; rename them, or remove the folder to do without pictures"
            )
    return {name: paths for name, paths in found.items() if paths}


def sizes_px(files: Mapping[str, Mapping[int, Path]]) -> dict[str, tuple[int, int]]:
    """Return width and height of the first picture of each camera."""
    first = {name: paths[min(paths)] for name, paths in files.items()}
    return {name: picture_size(path, path) for name, path in first.items()}


def calibrated_cameras(
    files: Mapping[str, Mapping[int, Path]], cameras: Mapping[str, Camera], skipped: Counter[str]
) -> tuple[Camera, ...]:
    """Return the cameras that have both pictures and a calibration; pictures without one are counted.

    Raises:
        BadInput: The first picture of a camera has another size than its calibration says.
    """
    found = []
    for name, paths in files.items():
        camera = cameras.get(name)
        if camera is None:
            skipped[f"{name} picture without calibration"] += len(paths)
        else:
            first = paths[min(paths)]
            check_picture_size(first, camera.width_px, camera.height_px, first)
            found.append(camera)
    return tuple(found)


def pictures_of_frames(
    name: str,
    paths: Mapping[int, Path],
    frames: Sequence[Frame],
    times: Mapping[int, int] | None,
    skipped: Counter[str],
) -> dict[int, Picture]:
    """Return the picture of each frame that has one; what is left out is counted.

    Args:
        name: The name of the camera.
        paths: Its pictures by frame number; at least one.
        frames: The frames of the drive.
        times: When each was taken, by frame number; None where they are taken at the times of the sweeps.
        skipped: The counts, by reason.

    Raises:
        BadInput: No picture has the number of a frame.
    """
    pictures = {}
    for frame in frames:
        if frame.index not in paths:
            skipped[f"no {name} picture"] += 1
        elif times is not None and frame.index not in times:
            skipped[f"{name} picture without time stamp"] += 1
        else:
            time_ns = frame.time_ns if times is None else times[frame.index]
            pictures[frame.index] = Picture(paths[frame.index], time_ns)
    if not any(frame.index in paths for frame in frames):
        raise BadInput(
            f"{describe_files(next(iter(paths.values())).parent)}, none with the number of a sweep "
            f"({frames[0].index} to {frames[-1].index}); give pictures and sweeps the same numbers, or remove the "
            "folder to do without pictures"
        )
    return pictures
