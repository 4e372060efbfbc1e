"""The drives of the simulated archive of bench/archive.py, as a package of somebody else would add them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

from archive_server import segment_name
from upvl_cli.datasets.registry import DatasetFamily


class Archive:
    """Drives that have names and nothing else: `root` says how many."""

    version = 1
    fingerprint_values: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self.segments = tuple(segment_name(number) for number in range(int(root.name)))

    def open(self, segment: str) -> NoReturn:
        """Refuse: there is nothing to open."""
        raise AssertionError(f"{segment} was opened")


def _open(root: Path, config: None) -> Archive:
    return Archive(root)


FAMILY = DatasetFamily(_open)
ENTRY_POINTS = "[upvl.datasets]\narchive = archive_plugin:FAMILY\n"
