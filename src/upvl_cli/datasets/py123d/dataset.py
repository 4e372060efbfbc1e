"""A folder of py123d data: the logs below `logs`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.py123d.drive import Py123dDrive, open_drive
from upvl_cli.datasets.shared.folders import entries, is_link, list_at_once
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
        folders = [folder for split in find(root, ["logs/*"]) for folder in _log_folders(split)]
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


def _log_folders(folder: Path) -> Iterator[Path]:
    """Yield the folders that are logs; below one there is no other."""
    try:
        found = entries(folder)
    except OSError:  # a file, or another one's folder
        return
    if ("sync.arrow", False) in found:
        yield folder
        return
    names = [name for name, is_folder in found if is_folder and not is_link(folder / name)]
    list_at_once(folder, names)
    for name in names:
        yield from _log_folders(folder / name)


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
