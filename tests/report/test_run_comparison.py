"""What changed between two runs: boxes that were moved, added and taken away by a known amount."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from report.made_up_run import FRAMES, THINGS, Thing, log_runs, made_up_run, write_labels
from report.test_report_page import read
from upvl_cli.report.comparison import BoxChanges, compare_drive, match_boxes
from upvl_cli.report.drive_labels import read_labels
from upvl_cli.report.run import write_report
from upvl_cli.types import TrackedBoxes


def boxes(*x_m: float, length_m: float = 4.0) -> TrackedBoxes:
    rows = np.array([[x, 0, 1, length_m, 2.0, 1.5, 0] for x in x_m]).reshape(-1, 7)
    n = len(x_m)
    return TrackedBoxes.from_rows(
        rows, velocity_mps=np.zeros((n, 3)), score=np.ones(n), track_id=np.arange(n)
    )


def test_boxes_match_the_ones_that_they_overlap_most() -> None:
    match = match_boxes(boxes(0, 10, 30), boxes(10.5, 0))
    assert dict(zip(match.before.tolist(), match.after.tolist(), strict=True)) == {0: 1, 1: 0}
    # 4 m boxes half a metre apart share 3.5 of 4.5 m.
    assert sorted(match.iou.tolist()) == pytest.approx([3.5 / 4.5, 1.0])


def test_small_boxes_match_by_near_centres() -> None:
    assert len(match_boxes(boxes(0, length_m=0.4), boxes(0.8, length_m=0.4)).iou) == 1
    assert len(match_boxes(boxes(0, length_m=0.4), boxes(1.2, length_m=0.4)).iou) == 0
    assert len(match_boxes(boxes(), boxes(1)).iou) == 0


CASES = [
    (THINGS, BoxChanges(kept=4)),
    (THINGS[:3], BoxChanges(kept=3, lost=1)),
    ((*THINGS, Thing(9, 20, -8)), BoxChanges(kept=4, new=1)),
    ((replace(THINGS[0], x_m=11.5), *THINGS[1:]), BoxChanges(kept=3, moved=1)),
    ((replace(THINGS[0], class_name="cyclist"), *THINGS[1:]), BoxChanges(kept=4, renamed=1)),
    ((), BoxChanges(lost=4)),
]


@pytest.mark.parametrize(("things", "expected"), CASES)
def test_changes_of_a_drive_add_up_over_its_frames(
    tmp_path: Path, things: tuple[Thing, ...], expected: BoxChanges
) -> None:
    workspace = made_up_run(tmp_path)
    before = read_labels(workspace, "street-0")
    write_labels(workspace, things)
    change = compare_drive(before, read_labels(workspace, "street-0"))
    assert change.changes == sum([expected] * FRAMES, BoxChanges())
    assert change.frames == FRAMES and change.frames_of_one == 0


def test_the_frame_that_changed_most_is_found(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    before = read_labels(workspace, "street-0")
    # A car that stands in this run is left behind by the one that drove: farther apart in each frame.
    write_labels(workspace, (replace(THINGS[0], speed_mps=0.0), *THINGS[1:]), frames=FRAMES - 1)
    change = compare_drive(before, read_labels(workspace, "street-0"))
    assert (change.frames, change.frames_of_one) == (FRAMES - 1, 1)
    # 1 m a frame: 3 / 5 in frame 1 is below 0.7; no overlap and 4 m apart in frame 4: lost and new.
    assert change.worst_place == 4
    assert change.worst == BoxChanges(kept=3, new=1, lost=1)


def test_page_tells_what_changed(tmp_path: Path) -> None:
    other = made_up_run(tmp_path, out="out2")
    write_labels(other, stamp='{"nms": {"version": 1, "values": {"max_iou": 0.2}}}')
    log_runs(other, labels=10.0)
    things = (replace(THINGS[0], x_m=11.5), *THINGS[1:3], Thing(9, 20, -8, class_name="cyclist"))
    workspace = made_up_run(tmp_path, things, with_points=True)
    write_labels(workspace, things, stamp='{"nms": {"version": 2, "values": {"max_iou": 0.3}}}')
    log_runs(workspace, labels=20.0)
    page = read(write_report(workspace, (), tmp_path / "page.html", tmp_path / "out2").path)
    assert "boxes kept 12 boxes moved 6 boxes new 6 boxes lost 6 boxes renamed 0" in page.text
    assert "cyclist 0 1 +1" in page.text and "unknown 1 0 -1" in page.text
    assert "nms.max_iou 0.2 0.3" in page.text and "version of nms 1 2" in page.text
    assert "labels 10.0 s 20.0 s" in page.text
    assert any(
        "2 kept" in (image["alt"] or "") or "1 new, 1 lost" in (image["alt"] or "")
        for image in page.all("img")
    )


def test_equal_runs_have_no_change(tmp_path: Path) -> None:
    made_up_run(tmp_path, out="out2")
    workspace = made_up_run(tmp_path)
    page = read(write_report(workspace, (), tmp_path / "page.html", tmp_path / "out2").path)
    assert "boxes kept 24 boxes moved 0 boxes new 0 boxes lost 0" in page.text
    assert "None: both runs have the same settings and versions." in page.text
    assert "The frame that changed most" not in page.text
