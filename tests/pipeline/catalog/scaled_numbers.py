"""A pipeline of five small stages over drives with files: what the tests of the catalogue damage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from upvl_cli.config.base import Config, setting
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.pipeline.pipeline import AnyStage, Pipeline
from upvl_cli.pipeline.stage import Inputs, Row, Stage, column
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Array, Frame


class FileDrive:
    """A drive of files with numbers, one a frame."""

    cameras, skipped, ground_z_m, world_from_ego = (), MappingProxyType({}), 0.0, None

    def __init__(self, folder: Path) -> None:
        self.name = folder.name
        try:
            self.files = tuple(sorted(folder.iterdir()))
        except OSError:
            raise BadInput(f"{folder} cannot be read") from None
        self.frames = tuple(Frame(index, index) for index in range(len(self.files)))


class FileDrives:
    version = 1
    fingerprint_values: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self._root = root
        self.opened = 0

    @property
    def segments(self) -> tuple[str, ...]:
        return tuple(sorted(path.name for path in self._root.iterdir()))

    def open(self, segment: str) -> FileDrive:
        self.opened += 1
        return FileDrive(self._root / segment)


@dataclass(frozen=True)
class FileFamily:
    config = None

    @staticmethod
    def open(root: Path, config: None) -> FileDrives:
        return FileDrives(root)


@dataclass(frozen=True)
class FactorConfig(Config):
    factor: float = setting("number that every x is multiplied with", ge=0, le=10)
    words: str = setting("folder with a file for each drive; empty for none")

    def files(self, segment: str) -> tuple[Path, ...]:
        path = Path(self.words, f"{segment}.txt")
        return (path,) if self.words and path.exists() else ()


@dataclass(frozen=True)
class SomeDrives(Config):
    drives: tuple[str, ...] = setting("names of the drives")


@dataclass(frozen=True)
class NoValues(Config):
    pass


@dataclass(frozen=True)
class NumberRow(Row):
    x_m: Array = column("float64", "an x", "m", per="point")


def scale(inputs: Inputs, config: FactorConfig) -> Iterator[NumberRow]:
    """Multiply the numbers of the drive."""
    for frame, path in zip(inputs.drive.frames, inputs.drive.files, strict=True):
        yield NumberRow(inputs.segment, frame.index, np.array([float(path.read_text()) * config.factor]))


def double(inputs: Inputs, config: NoValues) -> Iterator[NumberRow]:
    """Double what `scale` gives."""
    for row in inputs.table("scale", NumberRow):
        yield NumberRow(inputs.segment, row.frame, row.x_m * 2)


def total(inputs: Inputs, config: SomeDrives) -> Iterator[NumberRow]:
    """Add up the numbers of some drives."""
    numbers = [row.x_m.sum() for name in inputs.segments for row in inputs.table("scale", NumberRow, name)]
    yield NumberRow(inputs.segment, 0, np.array([sum(numbers)]))


def greatest(inputs: Inputs, config: SomeDrives) -> Iterator[NumberRow]:
    """Find the greatest number of all drives themselves."""
    numbers = [float(path.read_text()) for drive in inputs.drives() for path in drive.files]
    yield NumberRow(inputs.segment, 0, np.array([max(numbers, default=0.0)]))


def share(inputs: Inputs, config: NoValues) -> Iterator[NumberRow]:
    """Divide each number by that of all."""
    (row_of_all,) = inputs.table("total", NumberRow)
    for row in inputs.table("double", NumberRow):
        yield NumberRow(inputs.segment, row.frame, row.x_m / row_of_all.x_m)


STAGES: tuple[AnyStage, ...] = (
    Stage("scale", scale, FactorConfig, NumberRow, reads=("raw",)),
    Stage("double", double, NoValues, NumberRow, reads=("scale",)),
    Stage("total", total, SomeDrives, NumberRow, reads=("raw", "scale"), scope="dataset"),
    Stage("greatest", greatest, SomeDrives, NumberRow, reads=("raw",), scope="dataset"),
    Stage("share", share, NoValues, NumberRow, reads=("raw", "double", "total", "greatest")),
)


def _family(name: str) -> FileFamily:
    return FileFamily()


def _no_model(name: str) -> Any:
    raise BadSetting(f"unknown model {name!r}")


def make(folder: Path, drives: int) -> Workspace:
    """A workspace with that many drives of two files, and a preset `large`."""
    for number in range(drives):
        add_drive(folder, f"d{number}")
    stages = folder / "stages"
    (stages / "presets" / "large").mkdir(parents=True)
    (stages / "presets" / "large" / "scale.toml").write_text("factor = 3.0\n")
    write_raw(folder)
    (stages / "scale.toml").write_text('factor = 2.0\nwords = ""\n')
    (stages / "double.toml").write_text("")
    (stages / "total.toml").write_text('drives = ["*"]\n')
    (stages / "greatest.toml").write_text('drives = ["d[0-2]"]\n')
    (stages / "share.toml").write_text("")
    return workspace_of(folder)


def write_raw(folder: Path, *, segments: str = "[]", immutable: str = "false") -> None:
    (folder / "stages" / "raw.toml").write_text(
        f'dataset = "files"\nroot = "{folder / "drives"}"\nsegments = {segments}\nimmutable_files = {immutable}\n'
    )


def add_drive(folder: Path, name: str) -> None:
    drive = folder / "drives" / name
    drive.mkdir(parents=True)
    for index in range(2):
        (drive / f"{index}.txt").write_text(f"{index + 1}.0")


def workspace_of(folder: Path, preset: str = "", version: int = 1, out: Path | None = None) -> Workspace:
    """The workspace as a new command finds it.

    Args:
        folder: Where `make` put it.
        preset: Whose values stand over the others.
        version: That of the code of `double`.
        out: Where the shards are; None for `out` of the folder.
    """
    stages = tuple(replace(stage, version=version) if stage.name == "double" else stage for stage in STAGES)
    pipeline = Pipeline(stages, ("scale", "double"), _family, _no_model, lambda drive, config: drive)
    return Workspace(pipeline, folder / "stages", out or folder / "out", preset)
