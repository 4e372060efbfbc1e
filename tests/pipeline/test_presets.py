"""Presets: a few values differ, and no shard with an equal stamp is made twice."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from command import make_workspace, set_value
from tiny_kitti import write_drive
from upvl_cli.commands.pipeline import PIPELINE, STAGES
from upvl_cli.commands.status import status
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.presets import make_labels, preset_workspace
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace

FROM_PROPOSE = [
    "propose",
    "track",
    "amodal",
    "nms",
    "looks",
    "match-boxes2d",
    "classify",
    "labels",
    "pool-features",
]
FROM_MASK = ["mask", *FROM_PROPOSE]


@pytest.fixture
def base(tmp_path: Path) -> Workspace:
    """A workspace on a tiny drive, with no preset but those of the test."""
    drive = write_drive(tmp_path / "drives")
    folder = make_workspace(tmp_path / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    shutil.rmtree(folder / "stages" / "presets")
    return Workspace(PIPELINE, folder / "stages", folder / "out")


def preset(base: Workspace, name: str, **values: str) -> Workspace:
    """The workspace of a new preset, with `stage="key = value"`."""
    folder = base.stages / "presets" / name
    folder.mkdir(parents=True, exist_ok=True)
    for stage, text in values.items():
        (folder / f"{stage}.toml").write_text(f"{text}\n")
    return preset_workspace(base, name)


def made(base: Workspace, workspace: Workspace, *others: Workspace) -> list[str]:
    """The stages of which a shard was made, not found."""
    (segment,) = base.segments
    return [
        shard.stage
        for shard in make_labels(base, workspace, others, segment, lambda: None)
        if not shard.fresh
    ]


def own(workspace: Workspace) -> list[str]:
    """The stages whose shard is no second name of another workspace's."""
    (segment,) = workspace.segments
    shards = {
        stage.name: workspace.shard(stage.name, WHOLE_DATASET if stage.is_of_dataset else segment)
        for stage in PIPELINE.labelling_stages
    }
    return [name for name, shard in shards.items() if shard.stat().st_nlink == 1]


def test_a_preset_holds_all_values_and_differs_in_its_own(base: Workspace) -> None:
    workspace = preset(base, "bold", mask="min_speed_mps = 0.25")
    assert workspace.settings(PIPELINE.by_name["mask"]).min_speed_mps == 0.25
    assert workspace.raw == base.raw
    for stage in STAGES:
        if stage.name != "mask":
            assert workspace.settings(stage) == base.settings(stage)


def test_what_is_equal_is_shared(base: Workspace) -> None:
    assert made(base, base) == [stage.name for stage in PIPELINE.labelling_stages]
    first = preset(base, "first", mask="min_speed_mps = 0.25")
    assert made(base, first) == FROM_MASK
    assert own(first) == FROM_MASK
    # The second preset's mask is the first one's: only what differs is made.
    second = preset(base, "second", mask="min_speed_mps = 0.25", propose="background.max_share = 0.5")
    assert made(base, second, first) == FROM_PROPOSE
    assert own(second) == FROM_PROPOSE
    assert made(base, second, first) == made(base, first) == made(base, base) == []


def test_what_ships_is_made_only_as_far_as_it_is_shared(base: Workspace) -> None:
    (segment,) = base.segments
    workspace = preset(base, "bold", mask="min_speed_mps = 0.25")
    assert made(base, workspace) == [stage.name for stage in PIPELINE.labelling_stages]
    assert base.shard("flow", segment).samefile(workspace.shard("flow", segment))
    assert not base.shard("mask", segment).exists()


def test_the_folder_of_a_preset_is_a_workspace_of_its_own(base: Workspace) -> None:
    workspace = preset(base, "bold", mask="min_speed_mps = 0.25")
    made(base, workspace)
    again = Workspace(PIPELINE, workspace.stages, workspace.out)  # which preset it is, the folder says
    assert [(of.fresh, of.stale, of.missing) for of in status(again)][: len(PIPELINE.labelling_stages)] == [
        (1, 0, 0)
    ] * len(PIPELINE.labelling_stages)


def test_changed_files_of_the_drive_reach_every_preset(base: Workspace) -> None:
    workspace = preset(base, "bold", mask="min_speed_mps = 0.25")
    made(base, workspace)
    (segment,) = base.segments
    path = next(path for path in base.drive(segment).files if path.suffix == ".bin")
    os.utime(path)
    again = preset_workspace(Workspace(PIPELINE, base.stages, base.out), "bold")
    assert made(Workspace(PIPELINE, base.stages, base.out), again) == []  # what counts is what is in them
    path.write_bytes(path.read_bytes()[:-16])
    again = preset_workspace(Workspace(PIPELINE, base.stages, base.out), "bold")
    assert made(Workspace(PIPELINE, base.stages, base.out), again) == [
        stage.name for stage in PIPELINE.labelling_stages
    ]


def test_a_preset_of_no_difference_shares_everything(base: Workspace) -> None:
    workspace = preset(base, "same", mask="min_speed_mps = 1")
    made(base, workspace)
    assert own(workspace) == []


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        (
            "mask.toml",
            "min_sped_mps = 1",
            "odd/mask.toml: unknown key 'min_sped_mps'; did you mean 'min_speed_mps'",
        ),
        ("mask.toml", "min_speed_mps = -1", "odd/mask.toml: min_speed_mps = -1 must be >= 0"),
        ("mask.toml", "min_speed_mps =", "mask.toml is not valid TOML"),
        ("mask.toml", "min_speed_mps = inf", "odd/mask.toml: min_speed_mps = inf must be"),
        ("mask.toml", f"min_speed_mps = {'1' * 5000}", "odd/mask.toml is not valid TOML: Exceeds the limit"),
        ("mask.toml", f"min_speed_mps = {'1' * 400}", "odd/mask.toml: min_speed_mps = .* must be"),
        ("mask.toml", f"min_speed_mps = {'[' * 5000}", "odd/mask.toml is not valid TOML"),
        ("mist.toml", "", "holds mist.toml; expected files of stages: odometry, "),
        ("notes.txt", "", "holds notes.txt"),
    ],
)
def test_a_wrong_preset_is_refused(base: Workspace, file: str, text: str, message: str) -> None:
    folder = base.stages / "presets" / "odd"
    folder.mkdir(parents=True)
    (folder / file).write_text(text)
    with pytest.raises(BadSetting, match=message) as refusal:
        preset_workspace(base, "odd")
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 500


def test_a_wrong_value_that_ships_is_not_the_presets_fault(base: Workspace) -> None:
    set_value(base.stages.parent, "mask", "min_speed_mps", "-1.0")
    with pytest.raises(BadSetting, match="work/stages/mask.toml: min_speed_mps"):
        preset(base, "odd", propose="clustering.eps_m = [2.0]")


@pytest.mark.parametrize("name", [".{}.link", ".{}.part"])
def test_what_a_kill_left_behind_is_never_written_into(base: Workspace, name: str) -> None:
    made(base, base)
    (segment,) = base.segments
    shard = base.shard("nms", segment)
    content = shard.read_bytes()
    workspace = preset(base, "bold", nms="max_iou = 0.9")
    mine = workspace.shard("nms", segment)
    mine.parent.mkdir(parents=True)
    mine.with_name(name.format(mine.name)).hardlink_to(shard)
    assert made(base, workspace) == ["nms", "looks", "match-boxes2d", "classify", "labels", "pool-features"]
    assert shard.read_bytes() == content and not mine.samefile(shard)
    made(base, preset(base, "bold", nms=""))
    assert mine.samefile(shard)
    assert [path.name for path in mine.parent.iterdir()] == [mine.name]


def test_a_preset_that_is_not_there(base: Workspace) -> None:
    with pytest.raises(BadSetting, match="presets/none is missing"):
        preset_workspace(base, "none")
