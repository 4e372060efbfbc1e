"""Logs of Argoverse 2 (sensor and LiDAR data sets), read in place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.argoverse2.drive import SWEEPS, ArgoverseDrive, open_drive
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.folders import absolute
from upvl_cli.datasets.shared.paths import check_segment_name, find, unknown_segment
from upvl_cli.errors import BadInput

EXPECTED = "<root>/<split>/<log>/sensors/lidar/<time in ns>.feather"


class Argoverse2:
    """The logs below a folder: that of all splits, of one split, or of one log."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self._root = root
        self._folders = _log_folders(root)

    @property
    def segments(self) -> tuple[str, ...]:
        """Folder names of the logs, sorted."""
        return tuple(sorted(self._folders))

    def open(self, segment: str) -> ArgoverseDrive:
        """Return the log of that name; raises `BadInput` where there is none, or it is damaged."""
        if segment not in self._folders:
            raise unknown_segment(self._root, segment, self.segments)
        try:
            return open_drive(self._folders[segment])
        except OSError as error:  # a folder that may not be looked into
            raise unreadable(self._folders[segment], error) from None


def _log_folders(root: Path) -> dict[str, Path]:
    root = absolute(root)  # a root `.` has no name; links stay as they are
    folders: dict[str, Path] = {}
    for found in find(root, [SWEEPS, f"*/{SWEEPS}", f"*/*/{SWEEPS}"]):
        folder = found.parents[1]
        check_segment_name(folder.name, folder)
        if folder.name in folders:
            raise BadInput(f"{folder} and {folders[folder.name]} have one name; move one out of {root}")
        folders[folder.name] = folder
    if not folders:
        raise BadInput(f"{root} has no log of Argoverse 2; expected {EXPECTED}")
    return folders
