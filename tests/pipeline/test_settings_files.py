"""Files that the settings of a stage name: their content is part of the stamp, and make asks for it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from upvl_cli.config.base import Config, setting
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.executors.run import run_all
from upvl_cli.pipeline.make_rules import rules
from upvl_cli.pipeline.pipeline import Pipeline
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import Inputs, Row, Stage, column
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Array, Frame


class OneFrameDrive:
    """One frame."""

    cameras, skipped, ground_z_m, world_from_ego, files = (), MappingProxyType({}), 0.0, None, ()
    frames = (Frame(0, 0),)

    def __init__(self, name: str) -> None:
        self.name = name


class TwoDrives:
    version = 1
    segments = ("a", "b")
    fingerprint_values: Mapping[str, Any] = MappingProxyType({})

    def open(self, segment: str) -> OneFrameDrive:
        return OneFrameDrive(segment)


@dataclass(frozen=True)
class TwoDrivesFamily:
    config = None

    @staticmethod
    def open(root: Path, config: None) -> TwoDrives:
        return TwoDrives()


@dataclass(frozen=True)
class NumberConfig(Config):
    root: str = setting("folder of the numbers")

    def files(self, segment: str) -> tuple[Path, ...]:
        return tuple(sorted(Path(self.root, segment).glob("*.txt")))


@dataclass(frozen=True)
class NothingConfig(Config):
    pass


@dataclass(frozen=True)
class NumberRow(Row):
    x_m: Array = column("float64", "an x", "m", "ego", per="point")


def number(inputs: Inputs, config: NumberConfig) -> Iterator[NumberRow]:
    """Read a number."""
    yield NumberRow(
        inputs.segment, 0, np.array([float(path.read_text()) for path in config.files(inputs.segment)])
    )


def copy(inputs: Inputs, config: NothingConfig) -> Iterator[NumberRow]:
    """Copy it."""
    yield from inputs.table("number", NumberRow)


NUMBER = Stage("number", number, NumberConfig, NumberRow, reads=("raw",))
COPY = Stage("copy", copy, NothingConfig, NumberRow, reads=("number",))


def no_model(name: str) -> Any:
    raise BadSetting(f"unknown model {name!r}")


PIPELINE = Pipeline(
    (NUMBER, COPY), ("number", "copy"), lambda name: TwoDrivesFamily(), no_model, lambda drive, config: drive
)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A number for each drive, and the settings that name them."""
    folder = tmp_path / "numbers"
    for name in ("a", "b"):
        (folder / name).mkdir(parents=True)
        (folder / name / "0.txt").write_text("1")
    (tmp_path / "stages").mkdir()
    (tmp_path / "stages" / "raw.toml").write_text('dataset = "two"\nroot = ""\nsegments = []\n')
    (tmp_path / "stages" / "number.toml").write_text(f'root = "{folder}"\n')
    (tmp_path / "stages" / "copy.toml").write_text("")
    return tmp_path


def opened(root: Path) -> Workspace:
    return Workspace(PIPELINE, root / "stages", root / "out")


def made(root: Path) -> list[tuple[str, str]]:
    workspace = opened(root)
    shards = run_all(workspace, PIPELINE.stages, workspace.segments, overrides={})
    return [(shard.stage, shard.segment) for shard in shards if not shard.fresh]


def test_a_changed_file_remakes_its_drive_alone(root: Path) -> None:
    assert len(made(root)) == 4
    assert made(root) == []
    (root / "numbers" / "b" / "0.txt").write_text("2")
    workspace = opened(root)
    assert state(workspace, NUMBER, "a") == ("fresh", "")
    assert state(workspace, NUMBER, "b") == ("stale", "the files that the settings name have changed")
    assert made(root) == [("number", "b"), ("copy", "b")]
    assert opened(root).table("copy", NumberRow, "b")[0].x_m.tolist() == [2.0]


def test_a_new_file_and_a_renamed_one_are_changes(root: Path) -> None:
    made(root)
    (root / "numbers" / "a" / "1.txt").write_text("1")
    assert made(root) == [("number", "a"), ("copy", "a")]
    (root / "numbers" / "b" / "0.txt").rename(root / "numbers" / "b" / "3.txt")
    assert made(root) == [("number", "b"), ("copy", "b")]


def test_a_touched_file_is_none(root: Path) -> None:
    made(root)
    os.utime(root / "numbers" / "a" / "0.txt", (1, 1))
    assert made(root) == []


def test_files_that_are_gone_leave_the_stamp(root: Path) -> None:
    made(root)
    (root / "numbers" / "a" / "0.txt").unlink()
    assert state(opened(root), NUMBER, "a")[0] == "stale"


def test_make_compares_a_mark_of_them() -> None:
    text = rules(PIPELINE, ("a", "b"), {})
    assert "$(OUT)/number/%.parquet: $(OUT)/number.stamp $(OUT)/raw/%.stamp $(OUT)/number.files |" in text
    assert "$(OUT)/copy/%.parquet: $(OUT)/copy.stamp $(OUT)/number/%.parquet\n" in text
