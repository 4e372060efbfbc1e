"""A stage opens what it declares, and nothing else; stamps tell what made a shard."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from command import make_workspace, set_value
from upvl_cli.commands.pipeline import PIPELINE, STAGES
from upvl_cli.errors import NotMade
from upvl_cli.pipeline.inputs import ShardInputs
from upvl_cli.pipeline.provenance import difference
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.atomic import write_if_changed
from upvl_cli.stages.rows import FlowRow


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    folder = make_workspace(tmp_path)
    return Workspace(PIPELINE, folder / "stages", folder / "out")


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_an_undeclared_input_cannot_be_opened(workspace: Workspace, stage) -> None:  # noqa: ANN001
    blind = ShardInputs(workspace, replace(stage, reads=()), "street-0")
    with pytest.raises(LookupError, match="not in its reads"):
        blind.table("flow", FlowRow)
    with pytest.raises(LookupError, match="not in its reads"):
        _ = blind.drive


def test_a_declared_input_that_is_not_made_says_so(workspace: Workspace) -> None:
    with pytest.raises(NotMade, match="has not been made; run: make flow"):
        ShardInputs(workspace, PIPELINE.by_name["mask"], "street-0").table("flow", FlowRow)


def test_a_stamp_holds_every_value_of_a_stage_and_those_above(workspace: Workspace) -> None:
    stamp = json.loads(workspace.shard_stamp(PIPELINE.by_name["mask"], "street-0"))
    above = {"raw", "vlm", "odometry", "ground", "flow", "pca", "extract-vl"}
    assert set(stamp) == above | {"mask", "inputs"}
    assert stamp["mask"]["values"] == json.loads(
        json.dumps(asdict(workspace.settings(PIPELINE.by_name["mask"])))
    )
    assert stamp["vlm"]["model"] == "mini"


def test_a_changed_value_changes_the_stamps_below_and_no_other(tmp_path: Path) -> None:
    folder = make_workspace(tmp_path)
    before = {
        stage.name: Workspace(PIPELINE, folder / "stages", folder).stage_stamp(stage) for stage in STAGES
    }
    set_value(folder, "propose", "background.max_share", "0.9")
    after = {
        stage.name: Workspace(PIPELINE, folder / "stages", folder).stage_stamp(stage) for stage in STAGES
    }
    changed = [name for name in before if before[name] != after[name]]
    assert changed == [
        "propose",
        "track",
        "amodal",
        "nms",
        "looks",
        "match-boxes2d",
        "classify",
        "labels",
        "pool-features",
        "semantics",
        "train",
        "detect",
    ]
    assert difference(before["nms"], after["nms"]) == "propose.background.max_share 0.75 -> 0.9"


def test_a_mark_is_written_only_where_it_differs(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "mark"
    assert write_if_changed(path, "one")
    first = path.stat().st_mtime_ns
    assert not write_if_changed(path, "one")
    assert path.stat().st_mtime_ns == first
    assert write_if_changed(path, "two")
    assert path.read_text() == "two"
