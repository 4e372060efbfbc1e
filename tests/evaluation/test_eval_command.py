"""`upvl eval` whole, on a tiny KITTI drive with auto labels written by hand."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scored_world import write_auto_labels

from command import ROOT, fails, make_workspace, set_value, upvl
from tiny_kitti import TinyDrive, numbers, write_drive, write_tracklets
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.errors import UpvlError
from upvl_cli.evaluation.run import evaluate, render
from upvl_cli.pipeline.presets import with_preset
from upvl_cli.pipeline.workspace import Workspace

# The car of the drive is 4 m long, 12 m ahead, and drives at 8 m/s.
TABLE = """\
labels, moving-only, class-agnostic
drives 1, frames 4, labels 4, boxes 4
not counted: 1 boxes outside the labelled view

                    labels  AP L1  AP L2  APH L1  APH L2  precision  recall
AP@0.4  all              4  0.500  0.500   0.500   0.500      1.000   0.500
AP@0.4  below 30 m       4  0.500  0.500   0.500   0.500      1.000   0.500
AP@0.4  [30, 50) m       0  0.000  0.000   0.000   0.000      0.000   0.000
AP@0.4  from 50 m        0  0.000  0.000   0.000   0.000      0.000   0.000
precision and recall (level 2) at the cut-off of the best F1

best 2 boxes at IoU 0.4  boxes  share
right                        2   100%
misplaced                    0     0%
on the background            0     0%

labels missed at IoU 0.4  labels  missed  share
points: from 100 points        4       2    50%
range: below 30 m              4       2    50%
in view                        4       2    50%
speed: [3, 10) m/s             4       2    50%

out/eval/labels-moving-only.json
out/eval/labels-moving-only-precision-recall.png
out/eval/labels-moving-only-range.png
out/eval/labels-moving-only-speed.png
out/eval/labels-moving-only-errors.png
"""
TRACKS = """\
tracks, moving-only, class-agnostic
drives 1, frames 4, labels 4, boxes 4
not counted: 1 boxes outside the labelled view

             labels   MOTA   MOTP  missed  false  mismatched  score from
IoU 0.4  L1       4  0.250  0.200   0.500  0.000       0.250        0.81
IoU 0.4  L2       4  0.250  0.200   0.500  0.000       0.250        0.81
MOTP is the mean of 1 - IoU: lower is better

out/eval/tracks-moving-only.json
"""


def boxes_of(drive: TinyDrive) -> Mapping[int, list[tuple[np.ndarray, float, int]]]:
    """Two right boxes of two tracks, one 2 m too far, one on nothing, and one behind the camera."""
    car = drive.car.to_rows()
    shift, aside, behind = (
        np.eye(7)[0],
        np.array([0, -6.0, 0, 0, 0, 0, 0]),
        np.array([-40.0, 0, 0, 0, 0, 0, 0]),
    )
    return {
        0: [(car[0], 0.9, 1), (car[0] + behind, 0.95, 3)],
        1: [(car[1] + shift, 0.85, 2)],
        2: [(car[2] + 2 * shift, 0.8, 2)],
        3: [(car[3] + aside, 0.3, 4)],
    }


@pytest.fixture
def drive(tmp_path: Path) -> TinyDrive:
    return write_drive(tmp_path / "drives")


@pytest.fixture
def workspace(drive: TinyDrive, tmp_path: Path) -> Path:
    values = {"raw__dataset": '"kitti"', "raw__root": f'"{drive.root}"', "eval__iou": "[0.4]"}
    folder = make_workspace(tmp_path / "work", **values)
    write_auto_labels(folder, drive.segment, boxes_of(drive))
    return folder


def printed(folder: Path, *arguments: str) -> str:
    """What the whole command prints."""
    done = upvl(folder, "eval", *arguments)
    assert done.returncode == 0, done.stderr
    return "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines())


def told(folder: Path, what: str = "labels", *, moving_only: bool = True, region: str | None = None) -> str:
    """What it prints of the scores, without a process of its own."""
    workspace = Workspace(PIPELINE, folder / "stages", folder / "out")
    console = Console(file=io.StringIO(), width=200)
    for item in render(evaluate(workspace, what, moving_only, True, region, {})):
        console.print(item, markup=False, highlight=False)
    return console.file.getvalue()


def refused(folder: Path) -> str:
    """Why it is not scored."""
    with pytest.raises(UpvlError) as caught:
        told(folder)
    return str(caught.value)


def report(folder: Path, name: str = "labels-moving-only") -> dict:
    return json.loads((folder / "out" / "eval" / f"{name}.json").read_text())


def test_labels_are_scored_and_drawn_the_same_each_time(workspace: Path) -> None:
    assert printed(workspace, "--class-agnostic") == TABLE
    files = {path.name: path.read_bytes() for path in workspace.glob("out/eval/*")}
    pictures = sorted(name for name, content in files.items() if content.startswith(b"\x89PNG"))
    assert pictures == [
        f"labels-moving-only-{name}.png" for name in ("errors", "precision-recall", "range", "speed")
    ]
    found = report(workspace)
    assert found["detection"][0]["ap"] == pytest.approx([0.5, 0.5])
    assert found["scope"]["settings"]["iou"] == [0.4]
    assert found["flow"] is None

    for path in workspace.glob("out/eval/*"):
        path.unlink()
    without_a_word_on_classes = printed(workspace)
    assert without_a_word_on_classes == TABLE
    assert {path.name: path.read_bytes() for path in workspace.glob("out/eval/*")} == files


def test_odd_surroundings_change_no_picture_and_no_word(workspace: Path) -> None:
    pictures = workspace / "out/eval"
    command = ("eval", "--moving-only", "--class-agnostic")
    assert upvl(workspace, *command).returncode == 0
    before = {path.name: path.read_bytes() for path in pictures.iterdir()}
    (workspace / "matplotlibrc").write_text("axes.facecolor: red\nno.such.key: 1\nbackend: none\n")
    done = upvl(workspace, *command, MPLBACKEND="nonsense", HOME="/proc", MPLCONFIGDIR="/proc/x")
    assert (done.returncode, done.stderr) == (0, "")
    assert {path.name: path.read_bytes() for path in pictures.iterdir()} == before
    (workspace / "matplotlibrc").write_bytes(b"\xff")
    done = upvl(workspace, *command)
    assert done.returncode == 2
    assert "matplotlib, which draws the pictures, does not start" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_tracks_are_scored(workspace: Path) -> None:
    assert printed(workspace, "--what", "tracks", "--class-agnostic") == TRACKS
    assert report(workspace, "tracks-moving-only")["tracking"][1]["mota"] == pytest.approx(0.25)


@pytest.mark.parametrize(("preset", "mode"), [("", "all-motion"), ("moving-only", "moving-only")])
def test_the_labels_of_the_folder_decide_whether_standing_objects_count(
    drive: TinyDrive, tmp_path: Path, preset: str, mode: str
) -> None:
    """As `upvl autolabel --all-motion` and `--moving-only` leave the folder, with the values that ship."""
    folder = tmp_path / "shipped"
    shutil.copytree(ROOT / "stages", folder / "stages")
    for key, value in {"dataset": "kitti", "root": str(drive.root)}.items():
        set_value(folder, "raw", key, f'"{value}"')
    made_with = Workspace(PIPELINE, folder / "stages", folder / "out")
    with_preset(made_with, preset, made_with.pipeline.labelling_stages)
    write_auto_labels(folder, drive.segment, boxes_of(drive))
    assert printed(folder).startswith(f"labels, {mode}, class-agnostic\n")
    assert report(folder, f"labels-{mode}")["scope"]["mode"] == mode
    for other in ("all-motion", "moving-only"):
        assert told(folder, moving_only=other == "moving-only").startswith(f"labels, {other}, ")


@pytest.mark.parametrize(
    "arguments", [("--iou", "0.3", "--iou", "0.7"), ("--iou=0.7", "--all-motion", "0.3")]
)
def test_several_ious(workspace: Path, arguments: tuple[str, ...]) -> None:
    text = printed(workspace, *arguments)
    assert "AP@0.3  all              4  0.750" in text  # 2 m of 4 m too far is an IoU of 1 / 3
    assert "AP@0.7  all              4  0.250" in text


def test_a_region_cuts_both_sides(workspace: Path) -> None:
    # The car is at x = 12 to 12.95 m; the box that is 1 m too far is at 13.3 m.
    text = told(workspace, region="25.0x40")
    assert "labels, moving-only, class-agnostic, 25 x 40 m around the car\n" in text
    assert "drives 1, frames 4, labels 2, boxes 1" in text
    assert (
        "1 boxes outside the labelled view, 3 boxes outside the region, 2 labels outside the region" in text
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"what": "tracks", "agnostic": False},
            "tracks are scored whatever their class; run: upvl eval --what",
        ),
        ({"segments": ["nowhere"]}, "unknown segment 'nowhere'"),
        ({"what": "detections"}, "which is missing (not made); run: make detect"),
        ({"what": "boxes"}, "--what 'boxes': expected one of labels, detections, tracks"),
        ({"region": "40"}, "--region '40': expected length x width in metres around the car, such as 100x40"),
        ({"iou": [0.0]}, "iou[0] = 0.0 must be >= 0.001 and <= 1"),
        ({"iou": [float("nan")]}, "iou[0] = nan must be >= 0.001 and <= 1"),
        ({"iou": [0.5, 0.4]}, "eval: iou = [0.5, 0.4] must be ascending numbers, and at least one"),
    ],
)
def test_what_cannot_be_scored_is_told(workspace: Path, options: dict[str, Any], message: str) -> None:
    overrides = {"iou": options["iou"]} if "iou" in options else {}
    agnostic, region, segments = (
        options.get("agnostic", True),
        options.get("region"),
        options.get("segments", ()),
    )
    with pytest.raises(UpvlError, match=re.escape(message)):
        evaluate(
            Workspace(PIPELINE, workspace / "stages", workspace / "out"),
            options.get("what", "labels"), True, agnostic, region, overrides, segments,
        )  # fmt: skip


def test_edges_that_are_none(workspace: Path) -> None:
    set_value(workspace, "eval", "range_edges_m", "[]")
    assert "eval: range_edges_m = [] must be ascending numbers, and at least one" in refused(workspace)


def test_a_drive_without_labels(drive: TinyDrive, workspace: Path) -> None:
    (drive.folder / "tracklet_labels.xml").unlink()
    line = fails(workspace, "eval", "--class-agnostic")
    assert line == f"upvl: {drive.folder} has no labels; expected tracklet_labels.xml or object_label_2/*.txt"
    assert not (workspace / "out" / "eval").exists()


def test_a_drive_without_labels_among_others_is_left_out(drive: TinyDrive, workspace: Path) -> None:
    other = write_drive(drive.root, drive=2, tracklets=False)
    text = told(workspace)
    assert "drives 1, frames 4, labels 4, boxes 4" in text
    assert f"left out: {other.segment}: {other.folder} has no labels; expected tracklet_labels.xml" in text


def test_damaged_labels_are_no_missing_labels(drive: TinyDrive, workspace: Path) -> None:
    (drive.folder / "tracklet_labels.xml").write_text("<boost")
    assert "tracklet_labels.xml is not whole XML" in refused(workspace)


def test_labels_that_were_not_made(drive: TinyDrive, workspace: Path) -> None:
    (workspace / "out" / "nms" / f"{drive.segment}.parquet").unlink()
    assert "which is missing (not made); run: upvl autolabel --all-motion" in refused(workspace)


def test_labels_of_other_settings(workspace: Path) -> None:
    set_value(workspace, "mask", "min_speed_mps", "2.0")
    message = "which is stale (mask.min_speed_mps 1.0 -> 2.0); run: upvl autolabel --all-motion"
    assert message in refused(workspace)


def test_only_labelled_frames_count(drive: TinyDrive, workspace: Path) -> None:
    """Objects of single frames have no velocity, so none of them moves."""
    (drive.folder / "tracklet_labels.xml").unlink()
    (drive.folder / "object_label_2").mkdir()
    car = [0, 0, 0, 0, 0, 0, 0, 1.5, 1.8, 4.0, -2.0, 1.6, 12.0, -np.pi / 2]
    (drive.folder / "object_label_2" / "0000000001.txt").write_text(f"Car {numbers(car)}\n")
    text = told(workspace)
    assert "drives 1, frames 1, labels 1, boxes 1" in text
    assert "1 labels have no velocity and count as standing" in text
    assert "have no velocity" not in told(workspace, moving_only=False)


def test_nothing_labelled_and_nothing_found(drive: TinyDrive, workspace: Path) -> None:
    write_tracklets(drive.folder / "tracklet_labels.xml", np.zeros((0, 3)))
    write_auto_labels(workspace, drive.segment, {frame: [] for frame in range(4)})
    assert "drives 1, frames 4, labels 0, boxes 0" in told(workspace, "tracks")
    assert "drives 1, frames 4, labels 0, boxes 0" in printed(workspace)


@pytest.mark.real
@pytest.mark.slow
def test_a_real_drive(shared: Path, tmp_path: Path) -> None:
    root = shared / "data" / "kitti_raw_b"
    folder = make_workspace(tmp_path, raw__dataset='"kitti"', raw__root=f'"{root}"')
    assert upvl(folder, "autolabel", "--moving-only").returncode == 0
    text = printed(folder)
    # 44 frames of a tram, 41 and 33 of two cyclists in the front view; parked cars are not asked for.
    assert "AP@0.4  all            118 " in text
    assert 0.0 < report(folder)["detection"][0]["ap"][1] <= 1.0
