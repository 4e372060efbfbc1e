"""KITTI's raw recordings (`<date>/<drive>_sync`), read in place."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.kitti.drive import EXPECTED, KittiDrive, open_drive
from upvl_cli.errors import BadInput

_NAME = re.compile(r"[A-Za-z0-9._-]+")
_MOST_NAMES = 10


class Kitti:
    """The drives below a folder; the folder of one day or of one drive will do as well."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders = _drive_folders(root)

    @property
    def segments(self) -> tuple[str, ...]:
        """Folder names of the drives, sorted."""
        return tuple(sorted(self._folders))

    def open(self, segment: str) -> KittiDrive:
        """Return the drive of that name.

        Raises:
            BadInput: The name is not in `segments`, or the drive is damaged.
        """
        if segment not in self._folders:
            raise BadInput(f"{self._root} has no segment {segment!r}; {self._suggestion(segment)}")
        try:
            return open_drive(self._folders[segment])
        except OSError as error:  # a folder that may not be looked into
            raise _unreadable(self._folders[segment], error) from None

    def _suggestion(self, segment: str) -> str:
        if len(self.segments) <= _MOST_NAMES:
            return f"it has {', '.join(self.segments)}"
        close = difflib.get_close_matches(segment, self.segments)
        names = f"the nearest are {', '.join(close)}" if close else f"the first is {self.segments[0]}"
        return f"of its {len(self.segments)} segments {names}"


def _parents(root: Path, pattern: str) -> list[Path]:
    try:
        return sorted(found.parent for found in root.glob(pattern))
    except OSError as error:
        raise _unreadable(root, error) from None


def _unreadable(folder: Path, error: OSError) -> BadInput:
    return BadInput(f"{folder} cannot be read ({error.strerror}); check that it is there and readable")


def _drive_folders(root: Path) -> dict[str, Path]:
    root = Path(os.path.abspath(root))  # a root `.` has no name; links stay as they are
    folders: dict[str, Path] = {}
    for pattern in ("velodyne_points", "*/velodyne_points", "*/*/velodyne_points"):
        for folder in _parents(root, pattern):
            if not _NAME.fullmatch(folder.name):
                raise BadInput(
                    f"{folder}: a drive's name holds letters, digits, '.', '_', '-' only; rename it"
                )
            if folder.name in folders:
                raise BadInput(f"{folder} and {folders[folder.name]} have one name; move one out of {root}")
            folders[folder.name] = folder
    if not folders:
        raise BadInput(f"{root} has no drive of KITTI's raw data; expected {EXPECTED}")
    return folders
