"""Where the tables of a root lie, and the scenes in them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from upvl_cli.datasets.nuscenes.tables import KeyedTable, Row, read_table, text_of
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.folders import absolute, subfolders
from upvl_cli.datasets.shared.paths import check_segment_name
from upvl_cli.errors import BadInput

EXPECTED = "<root>/v1.0-trainval/scene.json (nuScenes), or <root>/annotation/scene.json (T4)"
_DEPTH = 3  # of T4: <root>/<dataset>/<version>/annotation


@dataclass(frozen=True, eq=False)
class Tables:
    """The tables of one folder; each is read when it is first needed.

    Attributes:
        folder: The folder of the tables.
        folders: The folders of files that were found inside the root so far, by the name in the table.
    """

    folder: Path
    folders: dict[str, Path] = field(default_factory=dict)

    @property
    def root(self) -> Path:
        """The folder to which file names are relative."""
        return self.folder.parent

    @property
    def is_t4(self) -> bool:
        """Whether the folder is one of TIER IV."""
        return self.folder.name == "annotation"

    @cached_property
    def samples(self) -> KeyedTable:
        """The samples (key frames) by scene."""
        return KeyedTable(self.folder / "sample.json", "scene_token")

    @cached_property
    def sample_data(self) -> KeyedTable:
        """The files of all sensors by sample."""
        return KeyedTable(self.folder / "sample_data.json", "sample_token")

    @cached_property
    def ego_poses(self) -> KeyedTable:
        """The poses of the car by token."""
        return KeyedTable(self.folder / "ego_pose.json", "token")

    @cached_property
    def mounts(self) -> dict[str, Row]:
        """The calibrated sensors by token."""
        return self.by_token("calibrated_sensor.json")

    @cached_property
    def sensors(self) -> dict[str, Row]:
        """The sensors by token."""
        return self.by_token("sensor.json")

    def by_token(self, name: str) -> dict[str, Row]:
        """Return the rows of a small table by token."""
        path = self.folder / name
        return {text_of(row, "token", path): row for row in read_table(path)}


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene.

    Attributes:
        name: Its name, for example "scene-0061".
        token: Its token.
        tables: The tables that it is in.
    """

    name: str
    token: str
    tables: Tables


def find_scenes(root: Path) -> dict[str, Scene]:
    """Return the scenes below a root by name.

    A scene that two folders of tables have, as v1.0-mini and v1.0-trainval do, is read from the larger one.

    Raises:
        BadInput: There is none, or two scenes have one name.
    """
    root = absolute(root)
    scenes: dict[str, Scene] = {}
    folders = sorted(_table_folders(root), key=lambda folder: (folder.name.endswith("mini"), folder))
    for folder in folders:
        tables, path = Tables(folder), folder / "scene.json"
        for row in read_table(path):
            name, token = check_segment_name(text_of(row, "name", path), path), text_of(row, "token", path)
            known = scenes.setdefault(name, Scene(name, token, tables))
            if known.token != token:
                raise BadInput(
                    f"{path} and {known.tables.folder / 'scene.json'} have two scenes {name}; name one of the folders "
                    "as root"
                )
    if not scenes:
        raise BadInput(f"{root} has no scene of nuScenes; expected {EXPECTED}")
    return scenes


def _table_folders(root: Path) -> list[Path]:
    """Return the folders of tables that are nearest below a root, or the root itself where it is one."""
    level = [root]
    for _ in range(_DEPTH + 1):
        found = [folder for folder in level if (folder / "scene.json").is_file()]
        if found:
            return found
        level = [child for folder in level for child in _children(folder)]
    raise BadInput(f"{root} has no tables of nuScenes; expected {EXPECTED}")


def _children(folder: Path) -> list[Path]:
    try:
        return [folder / name for name in subfolders(folder)]
    except OSError as error:
        raise unreadable(folder, error) from None
