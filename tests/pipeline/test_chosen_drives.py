"""A stage that is made from some of the drives asks for nothing of the others."""

from __future__ import annotations

from pathlib import Path

from command import make_workspace, set_value
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.make_rules import write_rules
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace

TRAIN = PIPELINE.by_name["train"]


def city(folder: Path, *, val: int, drives: str = '["train-*"]') -> Workspace:
    folder.mkdir(exist_ok=True)
    if not (folder / "stages").exists():
        make_workspace(folder, raw__dataset='"synthetic"')
    set_value(folder, "synthetic", "train", "2")
    set_value(folder, "synthetic", "val", str(val))
    set_value(folder, "train", "drives", drives)
    return Workspace(PIPELINE, folder / "stages", folder / "out")


def test_only_the_drives_that_are_learned_from_have_to_be_labelled(tmp_path: Path) -> None:
    workspace = city(tmp_path, val=1)
    assert workspace.segments == ("train-000", "train-001", "val-000")
    assert workspace.drives_of(TRAIN) == ("train-000", "train-001")
    assert {name for name, _ in workspace.sources(TRAIN, WHOLE_DATASET) if name.startswith("nms/")} == {
        "nms/train-000",
        "nms/train-001",
    }
    assert workspace.drives_of(PIPELINE.by_name["pca"]) == workspace.segments


def test_make_waits_for_no_other_drive(tmp_path: Path) -> None:
    text = write_rules(city(tmp_path, val=1)).read_text()
    (rule,) = (line for line in text.splitlines() if line.startswith("$(OUT)/train/all.parquet:"))
    assert "$(OUT)/nms/train-001.parquet" in rule
    assert "val-000" not in rule
    assert "SEGMENTS" not in rule


def test_one_drive_more_leaves_a_detector_fresh_that_does_not_learn_from_it(tmp_path: Path) -> None:
    before = city(tmp_path, val=1).shard_stamp(TRAIN, WHOLE_DATASET)
    assert city(tmp_path, val=2).shard_stamp(TRAIN, WHOLE_DATASET) == before
    assert city(tmp_path, val=1, drives='["*"]').shard_stamp(TRAIN, WHOLE_DATASET) != before
    assert city(tmp_path, val=2).shard_stamp(PIPELINE.by_name["pca"], WHOLE_DATASET) != city(
        tmp_path, val=1
    ).shard_stamp(PIPELINE.by_name["pca"], WHOLE_DATASET)
