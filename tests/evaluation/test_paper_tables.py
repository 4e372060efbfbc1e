"""The paper's tables: every row is told of, and those that can be made are filled."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scored_world import material

from command import ROOT, fails, make_workspace, set_value, upvl
from tiny_kitti import write_drive
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.evaluation.paper import COLUMNS, TABLES, PaperRow
from upvl_cli.evaluation.paper_tables import missing, presets
from upvl_cli.evaluation.score import named_scores
from upvl_cli.pipeline.presets import preset_workspace
from upvl_cli.pipeline.workspace import Workspace

ROWS = [(table, row) for table in TABLES for row in table.rows]


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    drive = write_drive(folder / "drives", frames=6)
    return make_workspace(folder / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')


@pytest.mark.parametrize(("table", "row"), ROWS, ids=lambda item: getattr(item, "name", ""))
def test_a_row_has_a_figure_a_column(table, row) -> None:
    assert len(row.published) == len(COLUMNS[table.score])


@pytest.mark.parametrize("name", sorted(path.name for path in (ROOT / "stages" / "presets").iterdir()))
def test_every_preset_that_ships_can_be_loaded_and_has_a_row(workspace: Path, name: str) -> None:
    preset_workspace(Workspace(PIPELINE, workspace / "stages", workspace / "out"), name)
    elsewhere = {"small", "paper", "without-words"}  # presets of `upvl train` and `upvl autolabel`
    assert name in {row.preset for _, row in ROWS} | elsewhere


def test_named_rows_are_means_as_published() -> None:
    for _, row in ROWS:
        if len(row.published) == 3 and not math.isnan(row.published[0]):
            assert row.published[2] == pytest.approx((row.published[0] + row.published[1]) / 2, abs=0.0501)


def test_what_a_row_needs_is_told(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    assert missing(PaperRow("", "here", (), needs=("flow",)), tmp_path, detectors=False) == ""
    assert missing(PaperRow("", "", (), needs=()), tmp_path, detectors=False) == ""
    assert (
        missing(PaperRow("", "here", (), needs=("flow", "dream", "wish")), tmp_path, detectors=False)
        == "no dream yet"
    )
    assert (
        missing(PaperRow("", "gone", (), needs=("flow",)), tmp_path, detectors=False) == "no preset gone yet"
    )


def test_names_are_scored_apart_and_riders_count_as_walkers() -> None:
    labels = [(0, 10, 0, 5.0), (0, 20, 0, 5.0), (0, 30, 0, 5.0), (0, 40, 0, 5.0), (0, 50, 0, 0.0)]
    case = material(labels, [(0, 10, 0, 0.9), (0, 20, 0, 0.9), (0, 30, 0, 0.9), (0, 40, 0, 0.9)])
    case = replace(
        case,
        labels=replace(case.labels, type=np.array([1, 1, 2, 4, 2])),
        predictions=replace(case.predictions, type=np.array([1, 2, 4, 2])),
    )
    # Of two cars one is found. The three boxes for VRU are one on a car and two right, all of one score:
    # precision 2/3; moving VRU are all found, with the one that stands it is two of three.
    assert named_scores(case, iou=0.4, moving_mps=1.0) == pytest.approx((0.5, 2 / 3, 7 / 12))
    assert named_scores(case, iou=0.4, moving_mps=None) == pytest.approx((0.5, 4 / 9, 17 / 36))


@pytest.mark.slow
def test_the_command_fills_what_it_can_and_makes_nothing_twice(workspace: Path) -> None:
    made = presets(Workspace(PIPELINE, workspace / "stages", workspace / "out"), detectors=False)
    assert {"moving-only", "clustering"} <= set(made)
    assert not any(made.values())
    done = upvl(workspace, "tables")
    assert done.returncode == 0, done.stderr
    text = " ".join(done.stdout.split())
    assert "Table 1: moving objects, whatever their class" in text
    assert "published AP@0.4 L1 AP@0.4 L2 AP@0.5 L1 AP@0.5 L2 MI-UP labels 36.9 35.5 27.4 26.4 ours " in text
    assert "UP-VL detector 49.9 48.1 38.4 36.9 with --detectors" in text
    assert text.count("Not the same data.") == len(TABLES)
    tables = json.loads((workspace / "out" / "eval" / "tables.json").read_text())
    assert [table["title"] for table in tables] == [table.title for table in TABLES]
    first = tables[0]["rows"][0]
    assert first["missing"] == ""
    assert all(0 <= value <= 100 for value in first["ours"])

    again = upvl(workspace, "tables")
    assert "made stage" not in again.stdout
    assert done.stdout.endswith(again.stdout)


@pytest.mark.slow
def test_detectors_are_scored_where_they_have_not_learned(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drives", frames=6)
    write_drive(tmp_path / "drives", frames=6, drive=2)
    folder = make_workspace(tmp_path / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    refusal = fails(folder, "tables", "--detectors")
    assert "the detectors would learn from every drive that has labels; expected some to score in" in refusal
    set_value(folder, "train", "drives", '["*_0001_*"]')
    done = upvl(folder, "tables", "--detectors")
    assert done.returncode == 0, done.stderr
    assert "with --detectors" not in done.stdout
    tables = json.loads((folder / "out" / "eval" / "tables.json").read_text())
    rows = [row for table in tables for row in table["rows"]]
    assert not any(row["missing"] for row in rows)
    assert {row["preset"] for row in rows if "detector" in row["name"]} == {
        "moving-only",
        "moving-vl",
        "no-distillation",
        "",
    }
    looked_at = sorted(folder.glob("out/tables/*/detect/*.parquet"))
    assert {path.stem[-9:-5] for path in looked_at} == {"0002"}
    assert len(looked_at) == 3
    assert "made stage" not in upvl(folder, "tables", "--detectors").stdout


def test_without_labels_there_is_nothing_to_fill(workspace: Path, tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drives", tracklets=False)
    folder = make_workspace(tmp_path / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    assert fails(folder, "tables").endswith(
        "has no labels; expected tracklet_labels.xml or object_label_2/*.txt"
    )
    assert not list(folder.glob("out/*/*.parquet"))
