"""Labels go out, a person changes them, and the changes come back as a layer: through the commands."""

from __future__ import annotations

import contextlib
import csv
import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from export.labelled_workspace import SEGMENT, label_row, labelled_workspace
from upvl_cli.cli import run
from upvl_cli.evaluation.corrected_labels import CorrectedLabels
from upvl_cli.export.corrections import Corrections, corrections_path, read_corrections
from upvl_cli.export.gather import drive_with_boxes
from upvl_cli.pipeline.tables import Table, write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.correction_rows import corrected_boxes, corrections_table
from upvl_cli.stages.rows import LabelRow


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return labelled_workspace(tmp_path / "work")


def folder(workspace: Workspace) -> Path:
    return workspace.stages.parent


def command(workspace: Workspace, *arguments: str, code: int = 0) -> str:
    """What a command prints in the workspace, run in this process: Python is started once."""
    printed, wrong = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder(workspace)), redirect_stdout(printed), redirect_stderr(wrong):
        assert run(arguments) == code, wrong.getvalue()
    return printed.getvalue() + wrong.getvalue()


def export(workspace: Workspace, *arguments: str) -> Path:
    command(workspace, "export", "csv", "to", *arguments)
    return folder(workspace) / "to" / f"{SEGMENT}.csv"


def edit(path: Path, change: dict[tuple[str, str], dict[str, str] | None]) -> None:
    """Change boxes of an exported table by frame and track; None deletes."""
    rows = list(csv.DictReader(path.read_text().splitlines()))
    kept = [row | (change.get((row["frame"], row["track_id"])) or {}) for row in rows
            if change.get((row["frame"], row["track_id"]), {}) is not None]  # fmt: skip
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(kept)


def import_back(workspace: Workspace) -> str:
    return command(workspace, "import-labels", "csv", "to")


def first_frame(workspace: Workspace) -> str:
    return str(Table(workspace.shard("labels", SEGMENT), LabelRow).frames[0])


def test_what_a_person_changed_is_a_layer_over_the_labels(workspace: Workspace) -> None:
    labels, frame = workspace.shard("labels", SEGMENT).read_bytes(), first_frame(workspace)
    path = export(workspace)
    edit(path, {(frame, "7"): {"class": "tram"}, (frame, "17"): {"center_x_m": "3.5"}, (frame, "27"): None})
    total = len(drive_with_boxes(workspace, SEGMENT, "labels", "class").boxes)
    assert import_back(workspace).startswith(
        f"{SEGMENT}: {total - 3} kept, 1 moved, 1 renamed, 0 new, 1 deleted; out/corrections/{SEGMENT}.parquet"
    )
    assert workspace.shard("labels", SEGMENT).read_bytes() == labels
    boxes = drive_with_boxes(workspace, SEGMENT, "corrected", "class").boxes
    here = boxes[boxes.frame == int(frame)]
    assert here.track_id.tolist() == [7, 17, 37, 47]
    assert here.class_name.tolist()[0] == "tram"
    assert here.center_m[1, 0] == 3.5
    assert here.score[:2].tolist() == [1.0, 1.0]


def test_corrections_leave_with_an_export_and_come_back_the_same(workspace: Workspace) -> None:
    frame = first_frame(workspace)
    edit(export(workspace), {(frame, "7"): {"class": "tram"}, (frame, "27"): None})
    import_back(workspace)
    before = corrections_path(workspace, SEGMENT).read_bytes()
    path = export(workspace)
    assert (frame, "tram") in [
        (row["frame"], row["class"]) for row in csv.DictReader(path.read_text().splitlines())
    ]
    import_back(workspace)
    assert corrections_path(workspace, SEGMENT).read_bytes() == before


def test_an_export_of_some_boxes_changes_no_others(workspace: Workspace) -> None:
    frame = first_frame(workspace)
    edit(export(workspace), {(frame, "7"): {"class": "tram"}})
    import_back(workspace)
    path = export(workspace, "--class", "pedestrian")
    edit(path, {(frame, "17"): None})
    import_back(workspace)
    corrections = read_corrections(workspace, SEGMENT)
    assert sorted(zip(corrections.track_id.tolist(), corrections.change.tolist(), strict=True)) == [
        (7, "renamed"),
        (17, "deleted"),
    ]


def test_corrections_of_other_labels_are_refused(workspace: Workspace) -> None:
    edit(export(workspace), {(first_frame(workspace), "7"): None})
    import_back(workspace)
    rows = list(Table(workspace.shard("labels", SEGMENT), LabelRow))
    boxes = drive_with_boxes(workspace, SEGMENT, "labels", "class").boxes
    changed = [label_row(row.frame, row.time_ns, boxes[boxes.frame == row.frame][:1]) for row in rows]
    write(workspace.shard("labels", SEGMENT), LabelRow, changed, stamp="{}", counts={})
    assert "made again since" in command(workspace, "export", "csv", "elsewhere", code=2)
    assert "made again since this export" in command(workspace, "import-labels", "csv", "to", code=2)
    assert "boxes in" in command(workspace, "export", "csv", "elsewhere", "--on", "labels")


def test_corrected_labels_can_be_scored_against(workspace: Workspace) -> None:
    frame = int(first_frame(workspace))
    edit(export(workspace), {(str(frame), "7"): {"class": "bus"}, (str(frame), "47"): None})
    import_back(workspace)
    source = CorrectedLabels(workspace)
    labels = source.labels(SEGMENT)
    here = labels[labels.frame == frame]
    assert here.object_id.tolist() == ["7", "17", "27", "37"]
    assert here.type.tolist() == [1, 2, 4, 0]
    assert len(source.frames(SEGMENT)) == len(workspace.drive(SEGMENT).frames)


def test_a_detector_learns_from_what_a_person_left(workspace: Workspace) -> None:
    frame = int(first_frame(workspace))
    edit(export(workspace), {(str(frame), "7"): {"center_x_m": "9.25"}, (str(frame), "47"): None})
    import_back(workspace)
    labels = Table(workspace.shard("labels", SEGMENT), LabelRow)[frame]
    boxes = corrected_boxes(labels, corrections_table(workspace.out / "corrections", SEGMENT)[frame])
    assert boxes.track_id.tolist() == [17, 27, 37, 7]
    assert boxes.center_m[-1, 0] == 9.25


def test_what_an_export_says_on_the_terminal(workspace: Workspace) -> None:
    first, *others = command(workspace, "export", "kitti", "to", "--moving", "--max-range", "20").splitlines()
    assert first.startswith("to: ")
    assert any("left out by the filters" in line for line in others)
    assert any(line.startswith("  velocities, for which the format has no place: ") for line in others)
    assert "did you mean 'kitti'" in command(workspace, "export", "kiti", "to", code=2)
    assert "unknown segment" in command(workspace, "export", "csv", "to", "--segment", "street-9", code=2)
    assert "is missing; name the folder" in command(workspace, "import-labels", "csv", "nowhere", code=2)


def test_a_damaged_manifest_is_named(workspace: Workspace) -> None:
    export(workspace)
    path = folder(workspace) / "to" / "upvl.json"
    path.write_text(json.dumps({"format": "csv", "classes": 3}))
    assert "upvl.json is no manifest of upvl" in command(workspace, "import-labels", "csv", "to", code=2)
    path.unlink()
    assert "0 deleted" in import_back(workspace)


def test_no_correction_is_a_correction_too(workspace: Workspace) -> None:
    export(workspace)
    import_back(workspace)
    corrections = read_corrections(workspace, SEGMENT)
    assert isinstance(corrections, Corrections)
    assert len(corrections) == 0
    assert len(CorrectedLabels(workspace).frames(SEGMENT)) > 1
    np.testing.assert_array_equal(
        drive_with_boxes(workspace, SEGMENT, "corrected", "class").boxes.center_m,
        drive_with_boxes(workspace, SEGMENT, "labels", "class").boxes.center_m,
    )
