"""The engine runs any pipeline that it is handed: here two toy stages over a toy dataset, nothing of ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pyarrow.parquet as pq
import pytest

from upvl_cli.config.base import Config, setting
from upvl_cli.errors import BadSetting, OutOfMemory
from upvl_cli.pipeline.executors.run import run_all
from upvl_cli.pipeline.make_rules import rules
from upvl_cli.pipeline.pipeline import Pipeline
from upvl_cli.pipeline.runner import Made, make_shard, state
from upvl_cli.pipeline.stage import WHOLE_DATASET, Inputs, Row, Stage, column
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Array, Frame, Points


class ToyDrive:
    """Three frames of two points."""

    cameras, skipped, ground_z_m, world_from_ego, files = (), MappingProxyType({}), 0.0, None, ()
    frames = tuple(Frame(index, index * 10**8) for index in (3, 5, 9))

    def __init__(self, name: str) -> None:
        self.name = name

    def points(self, frame: int) -> Points:
        return Points(np.full((2, 3), frame), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))

    def image(self, frame: int, camera: str) -> None:
        return None


class Toys:
    version = 1
    segments = ("a", "b")
    fingerprint_values: Mapping[str, Any] = MappingProxyType({})

    def open(self, segment: str) -> ToyDrive:
        return ToyDrive(segment)


@dataclass(frozen=True)
class Family:
    """A `DatasetAdapter`."""

    config = None

    @staticmethod
    def open(root: Path, config: None) -> Toys:
        return Toys()


@dataclass(frozen=True)
class DoubleConfig(Config):
    factor: float = setting("number that every x is multiplied with", "m", ge=0, le=10)


@dataclass(frozen=True)
class DoubleRow(Row):
    x_m: Array = column("float64", "an x", "m", "ego", per="point")


@dataclass(frozen=True)
class BoxedRow(Row):
    per_box: ClassVar[bool] = True

    size_m: Array = column("float64", "a size", "m", per="box", names=("length_m", "width_m"))


@dataclass(frozen=True)
class NoConfig(Config):
    pass


def double(inputs: Inputs, config: DoubleConfig) -> Iterator[DoubleRow]:
    """Multiply every x."""
    for frame in inputs.drive.frames:
        inputs.count("points", 2)
        yield DoubleRow(
            inputs.segment, frame.index, inputs.drive.points(frame.index).xyz_ego_m[:, 0] * config.factor
        )


def box(inputs: Inputs, config: NoConfig) -> Iterator[BoxedRow]:
    """Give frames beyond 3 one box; its width is that of the frame's points."""
    for row in inputs.table("double", DoubleRow):
        boxes = int(row.frame > 3)
        yield BoxedRow(inputs.segment, row.frame, np.tile([7.0, row.x_m[0]], (boxes, 1)))


def total(inputs: Inputs, config: NoConfig) -> Iterator[DoubleRow]:
    """Add up the widths of all drives."""
    widths = [
        row.size_m[:, 1].sum() for name in inputs.segments for row in inputs.table("box", BoxedRow, name)
    ]
    yield DoubleRow(inputs.segment, 0, np.array([sum(widths)]))


DOUBLE = Stage("double", double, DoubleConfig, DoubleRow, reads=("raw",))
BOX = Stage("box", box, NoConfig, BoxedRow, reads=("double",))
TOTAL = Stage("total", total, NoConfig, DoubleRow, reads=("box",), scope="dataset")


def family_of(name: str) -> Family:
    if name != "toys":
        raise BadSetting(f"unknown dataset {name!r}")
    return Family()


def no_model(name: str) -> Any:
    raise BadSetting(f"unknown model {name!r}")


TOY = Pipeline((DOUBLE, BOX, TOTAL), ("double", "box"), family_of, no_model, lambda drive, config: drive)


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    stages = tmp_path / "stages"
    stages.mkdir()
    (stages / "raw.toml").write_text('dataset = "toys"\nroot = ""\nsegments = []\n')
    (stages / "double.toml").write_text("factor = 2.0\n")
    (stages / "box.toml").write_text("")
    (stages / "total.toml").write_text("")
    return Workspace(TOY, stages, tmp_path / "out")


def run(workspace: Workspace) -> list[Made]:
    made = run_all(workspace, TOY.stages, workspace.segments, overrides={})
    return [shard for shard in made if not shard.fresh]


def test_two_stages_and_one_of_the_dataset_are_made_once(workspace: Workspace) -> None:
    assert [(made.stage, made.segment) for made in run(workspace)] == [
        ("double", "a"), ("box", "a"), ("double", "b"), ("box", "b"), ("total", WHOLE_DATASET)
    ]  # fmt: skip
    assert run(workspace) == []
    (row,) = workspace.table("total", DoubleRow)
    assert row.x_m.tolist() == [2 * 2 * (5 + 9)]


def test_a_table_of_boxes_has_a_row_a_box_and_every_frame(workspace: Workspace) -> None:
    run(workspace)
    shard = workspace.shard("box", "a")
    assert pq.read_table(shard).to_pydict() == {
        "segment": ["a", "a"], "frame": [5, 9], "length_m": [7.0, 7.0], "width_m": [10.0, 18.0]
    }  # fmt: skip
    rows = workspace.table("box", BoxedRow, "a")
    assert rows.frames == (3, 5, 9)
    assert [row.size_m.shape for row in rows] == [(0, 2), (1, 2), (1, 2)]
    assert pq.read_schema(shard).field("width_m").metadata[b"unit"] == b"m"


def test_a_changed_value_makes_what_follows_stale(workspace: Workspace) -> None:
    run(workspace)
    (workspace.stages / "double.toml").write_text("# a comment changes nothing\nfactor = 3.0\n")
    again = Workspace(TOY, workspace.stages, workspace.out)
    assert state(again, DOUBLE, "a") == ("stale", "double.factor 2.0 -> 3.0")
    assert len(run(again)) == 5


def test_a_stage_opens_what_it_reads_by_the_row_that_it_makes(workspace: Workspace) -> None:
    run(workspace)
    from upvl_cli.pipeline.inputs import ShardInputs

    with pytest.raises(LookupError, match="'double', which is not in its reads"):
        ShardInputs(workspace, replace(BOX, reads=()), "a").table("double", DoubleRow)
    with pytest.raises(TypeError, match="stage double makes no rows of BoxedRow"):
        ShardInputs(workspace, BOX, "a").table("double", BoxedRow)


def test_make_gets_rules_for_them(workspace: Workspace) -> None:
    text = rules(TOY, workspace.segments, {"total": ("a", "b")})
    assert "$(OUT)/box/%.parquet: $(OUT)/box.stamp $(OUT)/double/%.parquet\n" in text
    assert "$(OUT)/total/all.parquet: $(OUT)/total.stamp $(OUT)/box/a.parquet $(OUT)/box/b.parquet\n" in text
    assert "LABELLING := double box\n.PHONY: autolabel\nautolabel: $(LABELLING)\n\t@$(UPVL) summary\n" in text


def test_an_unknown_dataset_is_one_clear_error(workspace: Workspace) -> None:
    (workspace.stages / "raw.toml").write_text('dataset = "none"\nroot = ""\nsegments = []\n')
    with pytest.raises(BadSetting, match="unknown dataset 'none'"):
        _ = Workspace(TOY, workspace.stages, workspace.out).segments


def double_without_end(inputs: Inputs, config: DoubleConfig) -> Iterator[DoubleRow]:
    """Ask for more memory than any machine has, at the second frame."""
    frames = inputs.drive.frames
    yield DoubleRow(inputs.segment, frames[0].index, np.zeros(1))
    yield DoubleRow(inputs.segment, frames[1].index, np.zeros(10**18))


def test_want_of_memory_is_one_line_with_stage_and_frame(workspace: Workspace) -> None:
    stage = replace(DOUBLE, run=double_without_end)
    first = workspace.drive("a").frames[0].index
    with pytest.raises(
        OutOfMemory, match=f"double ran out of memory in a, after frame {first}; run it with fewer"
    ):
        make_shard(workspace, stage, "a", workspace.settings(DOUBLE), lambda: None)
    assert not workspace.shard("double", "a").exists()
