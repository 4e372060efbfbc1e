"""Results of nuScenes, taken by the classes of its devkit, scored against the tables, and read back."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.drives_with_data import drive_with_data
from export.labelled_drives import labelled_drive
from upvl_cli.datasets.nuscenes.dataset import NuScenes as NuScenesFolder
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.se3 import compose, from_yaw

FORMAT = export_format("nuscenes-results")
NO_DEVKIT = "needs nuscenes-devkit: pip install 'upvl[nuscenes]'"
KNOWN = 3  # of the five objects: vehicle, pedestrian and cyclist are classes of the tasks


def write(folder: Path, *drives: ExportDrive, name: str = "nuscenes-results") -> dict[str, int]:
    return export(drives, export_format(name), folder, ExportOptions(with_data=True), Counter())


def results_of(folder: Path, file: str = "results.json") -> dict[str, list[dict[str, Any]]]:
    results: dict[str, list[dict[str, Any]]] = json.loads((folder / file).read_text())["results"]
    return results


def test_the_devkit_takes_one_file_for_both_tasks(tmp_path: Path) -> None:
    loaders = pytest.importorskip("nuscenes.eval.common.loaders", reason=NO_DEVKIT)
    from nuscenes.eval.common.config import config_factory
    from nuscenes.eval.detection.data_classes import DetectionBox
    from nuscenes.eval.tracking.data_classes import TrackingBox

    config_factory("tracking_nips_2019")  # which tells the devkit the classes of the task
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    path = str(tmp_path / "out" / "results.json")
    detected, meta = loaders.load_prediction(path, 500, DetectionBox)
    tracked, _ = loaders.load_prediction(path, 500, TrackingBox)
    assert meta["use_lidar"] and not meta["use_map"]
    assert len(detected.sample_tokens) == len(tracked.sample_tokens) == len(drive.frames)
    own = drive.boxes[:KNOWN]
    first = tracked.sample_tokens[0]
    assert [box.tracking_id for box in tracked[first]] == [str(track) for track in own.track_id]
    assert [box.tracking_name for box in tracked[first]] == ["car", "pedestrian", "bicycle"]
    assert [box.detection_score for box in detected[first]] == own.score.tolist()
    assert [box.attribute_name for box in detected[first]][:2] == ["vehicle.moving", "pedestrian.moving"]


def test_the_devkit_scores_results_against_the_tables_as_perfect(tmp_path: Path) -> None:
    """The two exports of one drive, each read by the devkit: all places, turns and speeds agree."""
    algo = pytest.importorskip("nuscenes.eval.detection.algo", reason=NO_DEVKIT)
    from nuscenes.eval.common.data_classes import EvalBoxes
    from nuscenes.eval.common.loaders import load_prediction
    from nuscenes.eval.common.utils import center_distance
    from nuscenes.eval.detection.data_classes import DetectionBox
    from nuscenes.eval.detection.utils import category_to_detection_name
    from nuscenes.nuscenes import NuScenes

    drive = drive_with_data()
    write(tmp_path / "tables", drive, name="nuscenes")
    write(tmp_path / "out", drive)
    tables = NuScenes(version="v1.0-upvl", dataroot=str(tmp_path / "tables"), verbose=False)
    truth = EvalBoxes()
    for record in tables.sample_annotation:
        name = category_to_detection_name(record["category_name"])
        if name is not None:
            box = DetectionBox(
                sample_token=record["sample_token"],
                translation=record["translation"],
                size=record["size"],
                rotation=record["rotation"],
                velocity=tuple(tables.box_velocity(record["token"])[:2]),
                detection_name=name,
                attribute_name=tables.get("attribute", record["attribute_tokens"][0])["name"],
            )
            truth.add_boxes(record["sample_token"], [box])
    found, _ = load_prediction(str(tmp_path / "out" / "results.json"), 500, DetectionBox)
    for name in ("car", "pedestrian", "bicycle"):
        data = algo.accumulate(truth, found, name, center_distance, 0.5)
        assert algo.calc_ap(data, 0.1, 0.1) == pytest.approx(1.0)
        for metric in ("trans_err", "scale_err", "orient_err", "vel_err", "attr_err"):
            assert algo.calc_tp(data, 0.1, metric) == pytest.approx(0.0, abs=2e-3), metric


def test_what_the_devkit_would_refuse_stands_in_another_file(tmp_path: Path) -> None:
    drive = labelled_drive()
    lost = write(tmp_path / "out", drive)
    taken, others = results_of(tmp_path / "out"), results_of(tmp_path / "out", "other.json")
    assert {item["tracking_name"] for items in taken.values() for item in items} == {
        "car",
        "pedestrian",
        "bicycle",
    }
    assert {item["tracking_name"] for items in others.values() for item in items} == {"other", "fire_truck"}
    assert lost["boxes of a class that the tasks of nuScenes have not: written to other.json"] == 12


@pytest.mark.parametrize(
    "word, task",
    [
        ("taxi", "car"),
        ("garbage truck", "truck"),
        ("school bus", "bus"),
        ("construction worker", "pedestrian"),
        ("fire truck", None),  # an emergency vehicle, which the tasks do not score
        ("bicycle rack", None),
        ("carton", None),
    ],
)
def test_a_word_is_written_as_the_class_that_it_is_a_kind_of(
    word: str, task: str | None, tmp_path: Path
) -> None:
    drive = labelled_drive(frames=1)
    columns = {name: getattr(drive.boxes, name) for name in drive.boxes.__dataclass_fields__}
    names = np.array(["vehicle", word, "vehicle", "vehicle", "vehicle"])
    drive = drive.with_boxes(ExportBoxes(**columns | {"class_name": names}))
    lost = write(tmp_path / "out", drive)
    (items,) = results_of(tmp_path / "out").values()
    assert [item["tracking_name"] for item in items] == [
        "car",
        *([task] if task else []),
        "car",
        "car",
        "car",
    ]
    own = word.replace(" ", "_")
    if task:
        assert (
            lost[f"boxes of class {own!r}: written as {task}, the class in the further key class_name"] == 1
        )
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert sorted(back.class_name.tolist()) == sorted(names.tolist())


def test_more_boxes_than_the_devkit_takes_are_told(tmp_path: Path) -> None:
    drive = labelled_drive(frames=1)
    for many in (500, 501):
        boxes = drive.boxes[np.zeros(many, dtype=int)]
        columns = {name: getattr(boxes, name) for name in boxes.__dataclass_fields__}
        crowd = drive.with_boxes(ExportBoxes(**columns | {"track_id": np.arange(many)}))
        lost = write(tmp_path / str(many), crowd)
        assert lost.get("samples with more than 500 boxes, which the devkit refuses", 0) == many - 500


def test_a_frame_without_boxes_is_a_sample(tmp_path: Path) -> None:
    drive = labelled_drive()
    drive = drive.with_boxes(drive.boxes[drive.boxes.frame != drive.frames[2].index])
    write(tmp_path / "out", drive)
    assert [len(items) for items in results_of(tmp_path / "out").values()] == [3, 3, 0, 3, 3, 3]


def test_key_frames_of_nuscenes_keep_their_tokens(tmp_path: Path) -> None:
    labelled = drive_with_data()
    write(tmp_path / "set", labelled, name="nuscenes")
    path = tmp_path / "set" / "v1.0-upvl" / "sample_data.json"
    rows = json.loads(path.read_text())
    between = [row for row in rows if "LIDAR_TOP" in row["filename"]][1]
    between["is_key_frame"] = False
    path.write_text(json.dumps(rows))
    samples = [
        row["token"] for row in json.loads((tmp_path / "set" / "v1.0-upvl" / "sample.json").read_text())
    ]
    source = NuScenesFolder(tmp_path / "set").open("bend-1")
    boxes = ExportBoxes(
        **{name: getattr(labelled.boxes, name) for name in labelled.boxes.__dataclass_fields__}
        | {"frame": np.repeat(np.arange(6), 5)}
    )
    drive = replace(labelled, frames=source.frames, source=source).with_boxes(boxes)
    lost = write(tmp_path / "out", drive)
    assert list(results_of(tmp_path / "out")) == [samples[0], *samples[2:]]
    assert lost["boxes between the key frames of nuScenes: written to other.json"] == KNOWN
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert len(back) == len(drive.boxes)


def test_results_of_another_tool_need_no_table_of_samples(tmp_path: Path) -> None:
    """A detector that ran on the exported tables: their tokens, its own file, no ids, one task."""
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    results = results_of(tmp_path / "out")
    keys = (
        "sample_token",
        "translation",
        "size",
        "rotation",
        "velocity",
        "detection_name",
        "detection_score",
    )
    plain = {token: [{key: item[key] for key in keys} for item in items] for token, items in results.items()}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "results_nusc.json").write_text(json.dumps({"meta": {}, "results": plain}))
    back = read_back(FORMAT, tmp_path / "mine", {"bend-1": drive})["bend-1"]
    known = drive.boxes[np.isin(drive.boxes.class_name, ["vehicle", "pedestrian", "cyclist"])]
    np.testing.assert_allclose(back.center_m, known.center_m, atol=1e-6)
    assert back.class_name.tolist() == known.class_name.tolist()
    assert len(set(back.track_id.tolist())) == len(known)


def test_a_file_of_tracks_has_other_names(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    (tmp_path / "out" / "other.json").unlink()
    path = tmp_path / "out" / "results.json"
    content = json.loads(path.read_text())
    for items in content["results"].values():
        for item in items:
            for key in ("detection_name", "detection_score", "attribute_name"):
                del item[key]
    path.write_text(json.dumps(content))
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert back.class_name.tolist()[:3] == ["vehicle", "pedestrian", "cyclist"]
    assert back.score.tolist()[:3] == drive.boxes.score.tolist()[:3]
    assert back.track_id.tolist()[:3] == drive.boxes.track_id.tolist()[:3]


def test_boxes_stay_on_the_points_when_poses_were_refined_since(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    moved = compose(from_yaw(0.1, np.array([3.0, -2.0, 1.0])), drive.world_from_ego)
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": replace(drive, world_from_ego=moved)})["bend-1"]
    back = back[np.lexsort([back.track_id, back.frame])]
    np.testing.assert_allclose(back.center_m, drive.boxes.center_m, atol=1e-6)


def test_a_velocity_that_nobody_knows_is_told(tmp_path: Path) -> None:
    drive = labelled_drive()
    velocity = drive.boxes.velocity_mps.copy()
    velocity[0] = np.nan
    velocity[1, 2] += 1.0
    columns = {name: getattr(drive.boxes, name) for name in drive.boxes.__dataclass_fields__}
    lost = write(tmp_path / "out", drive.with_boxes(ExportBoxes(**columns | {"velocity_mps": velocity})))
    assert lost["boxes without a velocity: written as 0, as the devkit wants one"] == 1
    assert lost["velocities that point up or down: written along the world's x and y alone"] == 1
    assert "NaN" not in (tmp_path / "out" / "results.json").read_text()


@pytest.mark.parametrize(
    "content, message",
    [
        ("[", "is no JSON"),
        ('{"results": []}', "expected an object with a list for each sample"),
        ('{"results": {"x": []}}', "sample 'x' is no frame of a drive"),
        ('{"results": {"TOKEN": {}}}', "expected a list of boxes"),
        ('{"results": {"TOKEN": [{}]}}', "expected a list of 4 numbers"),
        ('{"results": {"TOKEN": [{"translation": [0,0,0], "rotation": [1,0,0,0], "size": [1,1,1]}]}}', "tracking_name"),
        ("{}", "has no labels of a drive"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_results_is_named(content: str, message: str, tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    token = next(iter(results_of(tmp_path / "out")))
    (tmp_path / "out" / "other.json").unlink()
    (tmp_path / "out" / "results.json").write_text(content.replace("TOKEN", token))
    with pytest.raises(BadInput, match=message) as failure:
        read_back(FORMAT, tmp_path / "out", {"bend-1": drive})
    assert "\n" not in str(failure.value)
