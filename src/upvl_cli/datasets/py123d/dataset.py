"""A folder of py123d data: the logs below `logs`."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.py123d.drive import Py123dDrive, open_drive
from upvl_cli.datasets.shared.numbered_files import describe_files
from upvl_cli.datasets.shared.paths import check_segment_name, find, unknown_segment
from upvl_cli.errors import BadInput


class Py123dLogs:
    """The logs of a folder of py123d data: every folder below a split that has a `sync.arrow`."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        """List the logs.

        Args:
            root: The folder with `logs/<split>/<log>/sync.arrow`, which py123d calls PY123D_DATA_ROOT.

        Raises:
            BadInput: There is no log, or two have the same name.
        """
        self._root = root
        folders = [
            Path(folder)
            for split in find(root, ["logs/*"])
            for folder, below, names in os.walk(split)
            if _is_log(below, names)
        ]
        if not folders:
            raise BadInput(
                f"{root} has no log of py123d; expected logs/<split>/<log>/sync.arrow in it, "
                f"found {describe_files(root)}"
            )
        self._folders = _folders_by_name(folders, root / "logs")
        self.segments = tuple(sorted(self._folders))

    def open(self, segment: str) -> Py123dDrive:
        """Return the drive of that name; raises `BadInput` where there is none or it is damaged."""
        if segment not in self._folders:
            raise unknown_segment(self._root, segment, self.segments)
        return open_drive(self._folders[segment], segment)


def _is_log(below: list[str], names: list[str]) -> bool:
    """Return whether a folder that `os.walk` visits is a log; below one there is no other."""
    found = "sync.arrow" in names
    if found:
        below.clear()
    return found


def _folders_by_name(folders: list[Path], logs: Path) -> dict[str, Path]:
    """Return the folder of each log by its name, with the names of its folders before it where two are equal."""
    count = Counter(folder.name for folder in folders)
    named: dict[str, Path] = {}
    for folder in folders:
        parts = folder.relative_to(logs).parts
        name = check_segment_name(folder.name if count[folder.name] == 1 else ".".join(parts), folder)
        if name in named:
            raise BadInput(f"{folder} and {named[name]} both have the name {name}; rename one")
        named[name] = folder
    return named
