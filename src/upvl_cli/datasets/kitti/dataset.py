"""KITTI's recordings, read in place: raw, object, tracking, odometry and KITTI-360, told apart by what is there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.kitti.drive import KittiDrive
from upvl_cli.datasets.kitti.kitti360 import FOLDER as KITTI360_FOLDER
from upvl_cli.datasets.kitti.kitti360 import open_kitti360
from upvl_cli.datasets.kitti.object import find_runs, open_object
from upvl_cli.datasets.kitti.odometry import open_odometry
from upvl_cli.datasets.kitti.raw import open_raw
from upvl_cli.datasets.kitti.tracking import open_tracking
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.folders import absolute, list_at_once, subfolders
from upvl_cli.datasets.shared.numbered_files import describe_files, numbered_files
from upvl_cli.datasets.shared.paths import check_segment_name, unknown_segment
from upvl_cli.errors import BadInput

_EXPECTED = (
    "<root>/2011_09_26/2011_09_26_drive_0001_sync/velodyne_points/data/0000000000.bin (raw), "
    "training/velodyne/000000.bin (object), training/velodyne/0000/000000.bin (tracking) "
    "sequences/00/velodyne/000000.bin (odometry) or data_3d_raw/<drive>/velodyne_points/data/0000000000.bin (KITTI-360)"
)
_RAW, _OTHERS = "velodyne_points", "velodyne"
_DEPTH = 3  # folders between the root and that of a drive: `dataset/sequences/00`
_RADAR = "radar"  # View-of-Delft has its radar's points in the same layout, beside the LiDAR's


@dataclass(frozen=True)
class KittiSegment:
    """One drive that was found: the folder that it is in, and how to open it."""

    folder: Path
    open: Callable[[], KittiDrive]


class Kitti:
    """The drives below a folder; the folder of one day, one split or one drive will do as well."""

    version = 2
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self._root = root
        self._segments = _find_segments(root)

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the drives, sorted."""
        return tuple(sorted(self._segments))

    def open(self, segment: str) -> KittiDrive:
        """Return the drive of that name.

        Raises:
            BadInput: The name is not in `segments`, or the drive is damaged.
        """
        if segment not in self._segments:
            raise unknown_segment(self._root, segment, self.segments)
        found = self._segments[segment]
        try:
            return found.open()
        except OSError as error:  # a folder that may not be looked into
            raise unreadable(found.folder, error) from None


def _find_segments(root: Path) -> dict[str, KittiSegment]:
    root = absolute(root)  # a root `.` has no name; links stay as they are
    found: dict[str, KittiSegment] = {}
    without: list[Path] = []
    for folder in _drive_folders(root, _DEPTH):
        named = list(_segments_of(folder))
        for name, segment in named:
            check_segment_name(name, segment.folder)
            if name in found:
                raise BadInput(
                    f"{segment.folder} and {found[name].folder} have one name; move one out of {root}"
                )
            found[name] = segment
        if not named:
            without.append(folder / _OTHERS)
    if not found:
        what = describe_files(without[0] if without else root)
        raise BadInput(f"{root} has no drive of KITTI's: {what}; expected {_EXPECTED}")
    return found


def _drive_folders(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the folders that hold sweeps, in order; none is looked for inside of another."""
    try:
        names = subfolders(folder)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        if depth == _DEPTH:
            raise unreadable(folder, error) from None
        return  # another one's folder beside the drives
    if _RAW in names or _OTHERS in names:
        yield folder
    elif depth > 0:
        names = [name for name in names if not name.startswith((".", _RADAR))]
        list_at_once(folder, names)
        for name in names:
            yield from _drive_folders(folder / name, depth - 1)


def _segments_of(folder: Path) -> Iterator[tuple[str, KittiSegment]]:
    """Yield name and drive of each of the drives of a folder."""
    if (folder / _RAW).is_dir():
        opener = open_kitti360 if folder.parent.name == KITTI360_FOLDER else open_raw
        yield folder.name, KittiSegment(folder, partial(opener, folder))
        return
    sweeps = folder / _OTHERS
    if numbered_files(sweeps, (".bin",)):
        if folder.parent.name == "sequences" or any(
            (folder / name).is_file() for name in ("calib.txt", "times.txt")
        ):
            yield folder.name, KittiSegment(folder, partial(open_odometry, folder))
            return
        for run in find_runs(folder):
            yield run.name, KittiSegment(folder, partial(open_object, run))
        return
    names = subfolders(sweeps)
    list_at_once(sweeps, names)
    for sequence in (sweeps / name for name in names):
        if numbered_files(sequence, (".bin",)):
            name = f"{folder.name}-{sequence.name}"
            yield name, KittiSegment(sequence, partial(open_tracking, sequence, name))
