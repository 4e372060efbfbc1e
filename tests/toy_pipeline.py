"""A pipeline that takes no time, for tests of where shards are made; importable, so that other processes have it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from upvl_cli.config.base import Config, setting
from upvl_cli.config.corrections import CorrectionsConfig
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.pipeline.pipeline import Pipeline
from upvl_cli.pipeline.stage import Inputs, Needs, Row, Stage, column
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Array, Drive, Frame


class NumberedDrive:
    """One frame; whoever reads it is killed, fails or waits some seconds as often as a file beside it says."""

    cameras, skipped, ground_z_m, world_from_ego, files = (), MappingProxyType({}), 0.0, None, ()
    frames = (Frame(0, 0),)

    def __init__(self, root: Path, name: str) -> None:
        self.name = name
        self._root = root

    def number(self) -> int:
        """Return the number in its name, unless a test wants something else to happen."""
        if self._take("kill"):
            os.kill(os.getpid(), signal.SIGKILL)
        if self._take("fail"):
            raise BadInput(f"{self.name} cannot be read; delete it")
        if self._take("bug"):
            raise ZeroDivisionError("a bug")
        if self._take("wait"):
            time.sleep(8)
        return int(self.name.partition("-")[2])

    def _take(self, what: str) -> bool:
        path = self._root / f"{what}-{self.name}"
        times = int(path.read_text()) if path.exists() else 0
        if times > 0:
            path.write_text(str(times - 1))
        return times > 0


class Numbers:
    """As many drives as a file says."""

    version = 1
    fingerprint_values: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, root: Path) -> None:
        self._root = root
        self.segments = tuple(f"drive-{number:03d}" for number in range(int((root / "count").read_text())))

    def open(self, segment: str) -> NumberedDrive:
        return NumberedDrive(self._root, segment)


@dataclass(frozen=True)
class NumbersFamily:
    """A `DatasetAdapter`."""

    config = None

    @staticmethod
    def open(root: Path, config: None) -> Numbers:
        return Numbers(root)


@dataclass(frozen=True)
class FactorConfig(Config):
    factor: float = setting("number that every number is multiplied with", ge=0, le=10)


@dataclass(frozen=True)
class EmptyConfig(Config):
    pass


@dataclass(frozen=True)
class NumberRow(Row):
    number: Array = column("float64", "a number", per="item")


def times(inputs: Inputs, config: FactorConfig) -> Iterator[NumberRow]:
    """Multiply the number of a drive."""
    drive: Any = inputs.drive
    yield NumberRow(inputs.segment, 0, np.array([drive.number() * config.factor]))


def count(inputs: Inputs, config: EmptyConfig) -> Iterator[NumberRow]:
    """Count the drives."""
    yield NumberRow(inputs.segment, 0, np.array([float(len(inputs.segments))]))


def share(inputs: Inputs, config: EmptyConfig) -> Iterator[NumberRow]:
    """Divide by the number of drives."""
    (all_of,) = inputs.table("count", NumberRow)
    yield NumberRow(inputs.segment, 0, inputs.table("times", NumberRow)[0].number / all_of.number)


def square(inputs: Inputs, config: EmptyConfig) -> Iterator[NumberRow]:
    """Square the share."""
    yield NumberRow(inputs.segment, 0, inputs.table("share", NumberRow)[0].number ** 2)


def check_number(workspace: Workspace, segment: str) -> Iterator[str]:
    """Check a drive as files beside it say, and count how often it was asked."""
    raw = workspace.out.parent / "raw"
    with (raw / f"checked-{segment}").open("a") as file:
        file.write("1")
    if (raw / f"odd-{segment}").exists():
        yield f"warning: {segment} is odd"
    if (raw / f"faulty-{segment}").exists():
        raise BadSetting(f"{segment} is faulty")


def numbers_of(name: str) -> NumbersFamily:
    if name != "numbers":
        raise BadSetting(f"unknown dataset {name!r}")
    return NumbersFamily()


def without_model(name: str) -> Any:
    raise BadSetting(f"unknown model {name!r}")


def uncorrected(drive: Drive, config: CorrectionsConfig) -> Drive:
    return drive


STAGES = (
    Stage("times", times, FactorConfig, NumberRow, reads=("raw",)),
    Stage("count", count, EmptyConfig, NumberRow, reads=("raw",), scope="dataset"),
    Stage("share", share, EmptyConfig, NumberRow, reads=("times", "count"), needs=Needs(gpus=1.0)),
    Stage("square", square, EmptyConfig, NumberRow, reads=("share",)),
)
NUMBERS = Pipeline(STAGES, ("times",), numbers_of, without_model, uncorrected)


def numbers_workspace(folder: Path, drives: int, out: Path | None = None) -> Workspace:
    """A workspace with some numbered drives; its shards are in its folder, or elsewhere."""
    stages = folder / "stages"
    stages.mkdir(parents=True)
    (folder / "raw").mkdir()
    (folder / "raw" / "count").write_text(str(drives))
    (stages / "raw.toml").write_text(f'dataset = "numbers"\nroot = "{folder / "raw"}"\nsegments = []\n')
    for stage in STAGES:
        (stages / f"{stage.name}.toml").write_text("factor = 2.0\n" if stage.name == "times" else "")
    return open_numbers(folder, out)


def open_numbers(folder: Path, out: Path | None = None) -> Workspace:
    """Open a workspace that `numbers_workspace` made."""
    return Workspace(NUMBERS, folder / "stages", out or folder / "out")


def numbered_shards(workspace: Workspace) -> dict[str, bytes]:
    """Every shard of a workspace, byte by byte."""
    return {
        str(path.relative_to(workspace.out)): path.read_bytes()
        for path in sorted(workspace.out.glob("*/*.parquet"))
    }
