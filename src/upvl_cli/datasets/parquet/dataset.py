"""A folder of drives as Parquet tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.parquet.drive import ParquetDrive, open_drive
from upvl_cli.datasets.shared.numbered_files import describe_files
from upvl_cli.datasets.shared.paths import check_segment_name, find, unknown_segment
from upvl_cli.errors import BadInput


class ParquetDrives:
    """The drives of a folder: one for each file of its folder `points`."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        """List the drives.

        Args:
            root: The folder with `points`, and if there are any `cameras`, `images` and `labels`.

        Raises:
            BadInput: There is no drive.
        """
        self._root = root
        paths = find(root, ["points/*.parquet"])
        if not paths:
            raise BadInput(
                f"{root} has no drive; expected points/<segment>.parquet in it, found {describe_files(root)}"
            )
        self.segments = tuple(sorted(check_segment_name(path.stem, path) for path in paths))
        self._names = frozenset(self.segments)

    def open(self, segment: str) -> ParquetDrive:
        """Return the drive of that name; raises `BadInput` where there is none or it is damaged."""
        if segment not in self._names:
            raise unknown_segment(self._root, segment, self.segments)
        return open_drive(self._root, segment)
