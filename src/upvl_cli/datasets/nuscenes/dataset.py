"""Scenes of nuScenes, Lyft Level 5 and T4, read in place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from upvl_cli.datasets.nuscenes.drive import NuScenesDrive, open_drive
from upvl_cli.datasets.nuscenes.layout import Scene, find_scenes
from upvl_cli.datasets.shared.paths import unknown_segment


class NuScenes:
    """The scenes below a folder: that of the data set, that of its tables, or that of several data sets of T4."""

    version = 1
    fingerprint_values: Mapping[str, object] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self._root = root
        self._scenes = find_scenes(root)

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the scenes, sorted."""
        return tuple(sorted(self._scenes))

    def scene(self, segment: str) -> Scene:
        """Return the scene of that name; raises `BadInput` where there is none."""
        if segment not in self._scenes:
            raise unknown_segment(self._root, segment, self.segments)
        return self._scenes[segment]

    def open(self, segment: str) -> NuScenesDrive:
        """Return the drive of a scene; raises `BadInput` where there is none, or a table is damaged."""
        return open_drive(self.scene(segment))
