"""Parts of a report: histograms, maps, costs and scores, with figures that a person can check."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from report.made_up_run import SEGMENT, THINGS, log_runs, made_up_run
from upvl_cli.report.costs import is_dropped, stage_costs
from upvl_cli.report.drive_labels import concat_tracks, read_labels, tracks_of
from upvl_cli.report.figures import HEIGHT, WIDTH, histogram, ranking, round_step
from upvl_cli.report.scores import score_sheets
from upvl_cli.report.settings import settings_between
from upvl_cli.report.track_map import track_map


@pytest.mark.parametrize(("span", "step"), [(10, 0.5), (100, 5), (24, 1), (0.9, 0.05), (0, 1), (25, 2)])
def test_steps_are_round(span: float, step: float) -> None:
    assert round_step(span, 24) == pytest.approx(step)


def test_histogram_stacks_classes_and_counts_every_value() -> None:
    plot = histogram(
        "t", "m", np.array([0.0, 0.5, 1.0, 12.0, np.nan]), ["vehicle", "odd", "vehicle", "vehicle", "odd"]
    )
    assert plot is not None
    titles = [bar.title for bar in plot.bars]
    assert titles == [
        "0 to 0.5: 1 vehicle",
        "0.5 to 1: 1 other",
        "1 to 1.5: 1 vehicle",
        "12 to 12.5: 1 vehicle",
    ]
    assert all(bar.x >= 0 and bar.x + bar.width <= WIDTH and 0 <= bar.y < HEIGHT for bar in plot.bars)
    assert histogram("t", "m", np.array([np.nan]), ["vehicle"]) is None


def test_two_classes_in_one_bin_stand_on_each_other() -> None:
    plot = histogram("t", "m", np.array([1.0, 1.0, 1.0]), ["vehicle", "vehicle", "cyclist"])
    assert plot is not None
    low, high = plot.bars
    assert low.height == pytest.approx(2 * high.height)
    assert high.y + high.height == pytest.approx(low.y)


def test_ranking_is_by_count_and_cuts_long_names() -> None:
    plot = ranking("t", ["car"] * 3 + ["a name that is far too long"] + ["bus"] * 2, ["vehicle"] * 6)
    assert plot is not None
    assert [(row.name, row.count) for row in plot.rows][:2] == [("car", 3), ("bus", 2)]
    assert plot.rows[2].short == "a name that is …"
    assert ranking("t", [], []) is None


def test_tracks_gather_their_boxes(tmp_path: Path) -> None:
    tracks = tracks_of(read_labels(made_up_run(tmp_path), SEGMENT))
    assert tracks.track_id.tolist() == [1, 2, 3, 4]
    assert tracks.num_boxes.tolist() == [6, 6, 6, 6]
    assert tracks.is_moving.tolist() == [True, True, False, False]
    assert tracks.duration_s == pytest.approx([0.5] * 4)
    assert tracks.top_speed_mps.tolist() == [10, 5, 0, 0]
    assert len(concat_tracks([tracks, tracks])) == 8


def test_drive_without_a_box_has_no_track_and_a_map_of_its_way(tmp_path: Path) -> None:
    labels = read_labels(made_up_run(tmp_path, ()), SEGMENT)
    tracks = tracks_of(labels)
    assert len(tracks) == 0
    plot = track_map(labels, tracks, np.tile(np.eye(4), (len(labels.frames), 1, 1)), 1e5)
    assert plot is not None and not plot.tracks


def test_map_has_the_scale_of_the_world(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    labels = read_labels(workspace, SEGMENT)
    tracks = tracks_of(labels)
    poses = np.tile(np.eye(4), (len(labels.frames), 1, 1))
    poses[:, 0, 3] = np.arange(len(labels.frames))
    plot = track_map(labels, tracks, poses, 1e5)
    assert plot is not None
    per_metre = plot.bar_width / float(plot.bar_text.removesuffix(" m"))
    ways = {track.title.split(":")[0]: track.way for track in plot.tracks}
    first, last = (
        np.array(place.split(","), float) for place in (ways["1"].split(" ")[0], ways["1"].split(" ")[-1])
    )
    # 10 m/s for 0.5 s along x, which points to the right.
    assert (last - first) / per_metre == pytest.approx([5.0, 0.0], abs=0.02)
    ego = [np.array(place.split(","), float) for place in plot.ego_way.split(" ")]
    assert (ego[-1] - ego[0]) / per_metre == pytest.approx([5.0, 0.0], abs=0.02)
    # y is up: the car at y = 3 m stands above the way of the ego car.
    assert (ego[0] - first)[1] / per_metre == pytest.approx(3.0, abs=0.02)
    assert [axis.name for axis in plot.axes] == ["x", "y"]
    assert ways["3"] == ""  # what stands has no way
    assert plot.left_out == 0


def test_map_of_a_way_along_y_is_turned(tmp_path: Path) -> None:
    labels = read_labels(made_up_run(tmp_path), SEGMENT)
    turn = np.eye(4)
    turn[:2, :2] = [[0, -1], [1, 0]]  # x of the car is y of the world
    poses = np.tile(turn, (len(labels.frames), 1, 1))
    poses[:, 1, 3] = 20 * np.arange(len(labels.frames))
    plot = track_map(labels, tracks_of(labels), poses, 1e5)
    assert plot is not None
    assert [(axis.x, axis.y, axis.name) for axis in plot.axes] == [(0, -1, "x"), (-1, 0, "y")]
    first, last = (np.array(place.split(","), float) for place in plot.ego_way.split(" "))
    assert last[0] < first[0] and last[1] == pytest.approx(first[1])  # y points to the left


def test_map_leaves_the_shortest_tracks_out_where_there_is_no_room(tmp_path: Path) -> None:
    things = [THINGS[2].__class__(number, 3.0 * number, 5.0) for number in range(30)]
    labels = read_labels(made_up_run(tmp_path, things), SEGMENT)
    plot = track_map(labels, tracks_of(labels), np.tile(np.eye(4), (len(labels.frames), 1, 1)), 1000)
    assert plot is not None
    assert (len(plot.tracks), plot.left_out) == (10, 20)


def test_costs_are_of_the_last_run_and_unknown_without_a_log(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    log_runs(workspace, labels=3.0)
    with (workspace.out / "runs.jsonl").open("a") as file:
        file.write(json.dumps({"stage": "labels", "segment": SEGMENT, "seconds": 6.0}) + '\n{"cut sh')
    costs = {cost.stage: cost for cost in stage_costs(workspace, [SEGMENT])}
    assert (costs["labels"].seconds, costs["labels"].peak_mib) == (6.0, None)
    assert costs["labels"].seconds_per_frame == 1.0
    assert costs["labels"].size_bytes == workspace.shard("labels", SEGMENT).stat().st_size
    assert costs["odometry"].seconds is None and costs["odometry"].seconds_per_frame is None
    assert "flow" not in costs


@pytest.mark.parametrize(
    ("reason", "dropped"),
    [
        ("boxes dropped: overlap a better one", True),
        ("tracks dropped: too few boxes", True),
        ("background", True),
        ("points slower than min_speed_mps, left out", True),
        ("points background", False),
        ("boxes kept", False),
    ],
)
def test_reasons_that_drop_are_told_from_counts(reason: str, dropped: bool) -> None:
    assert is_dropped(reason) is dropped


SCORES = {
    "scope": {
        "what": "labels", "mode": "moving-only", "region": {"length_m": 100.0, "width_m": 40.0},
        "segments": ["street-0"],
        "frames": 6, "labels": 12, "boxes": 24, "left_out": {}, "dropped": {"labels out of view": 3, "none": 0},
    },
    "detection": [
        {"objects": "all", "iou": 0.4, "labels": [9, 12], "ap": [0.9, 0.81], "aph": [0.8, None], "precision": 0.7,
         "recall": 0.6},
    ],
    "named": [], "tracking": [], "flow": None,
}  # fmt: skip


def test_scores_are_those_that_eval_wrote(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    folder = workspace.out / "eval"
    folder.mkdir()
    (folder / "labels-moving-only.json").write_text(json.dumps(SCORES))
    (folder / "broken.json").write_text("{")
    broken, sheet = score_sheets(workspace, [SEGMENT])
    assert "damaged" in broken.notes[0] and not broken.tables
    assert sheet.name == "labels, moving-only, 100 x 40 m around the car"
    assert sheet.notes == ("not counted: 3 labels out of view",)
    assert sheet.tables[0].rows == (("all", "0.4", "12", "0.900", "0.810", "0.800", "-", "0.700", "0.600"),)


def test_scores_of_other_drives_are_told(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    (workspace.out / "eval").mkdir()
    (workspace.out / "eval" / "labels-moving-only.json").write_text(json.dumps(SCORES))
    (sheet,) = score_sheets(workspace, ["street-0", "street-1"])
    assert sheet.notes[0] == "scored were 1 drives (street-0), not the drives of this report"


def test_settings_of_two_runs_are_compared_by_name() -> None:
    changes = settings_between(
        {"a.x": 1, "a.y": [1, 2], "a.z": True}, {"a.x": 1, "a.y": [1, 3], "a.zz": "on", "b.x": 1}
    )
    assert [(change.name, change.before, change.after) for change in changes] == [
        ("a.y", "[1, 2]", "[1, 3]"), ("a.z", "true", "none"), ("a.zz", "none", '"on"'),
    ]  # fmt: skip
