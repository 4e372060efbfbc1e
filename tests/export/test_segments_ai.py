"""Segments.ai: one car by hand, the types of its SDK, and what it gives back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import drive_of_one_car, read, write
from upvl_cli.errors import BadInput


def label(folder: Path, name: str = "one") -> dict[str, Any]:
    return json.loads((folder / f"{name}.label.json").read_text())


def test_a_car_ahead_that_heads_to_the_left(tmp_path: Path) -> None:
    write(drive_of_one_car(), "segments-ai", tmp_path)
    (frame,) = label(tmp_path)["frames"]
    (cuboid,) = frame["annotations"]
    # In world axes from the place of the first frame: the ego looks along y, so ahead is y and left is -x.
    np.testing.assert_allclose([cuboid["position"][axis] for axis in "xyz"], [-2, 10, 0.5], atol=1e-12)
    assert cuboid["dimensions"] == {"x": 4.0, "y": 2.0, "z": 1.5}
    assert abs(cuboid["yaw"]) == pytest.approx(np.pi)  # left of y is -x: half a turn from x
    turn = [cuboid["rotation"][name] for name in ("qx", "qy", "qz", "qw")]
    np.testing.assert_allclose(np.abs(turn), [0, 0, 1, 0], atol=1e-12)
    assert cuboid["track_id"] == 12 and cuboid["type"] == "cuboid"
    assert cuboid["attributes"]["score"] == 0.75
    (sampled,) = json.loads((tmp_path / "one.sample.json").read_text())["frames"]
    assert sampled["timestamp"] == "1500000000123456789"
    assert sampled["ego_pose"]["position"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    half = np.sqrt(0.5)
    np.testing.assert_allclose([sampled["ego_pose"]["heading"][name] for name in ("qz", "qw")], [half, half])
    task = json.loads((tmp_path / "task_attributes.json").read_text())
    assert [(entry["id"], entry["name"]) for entry in task["categories"]] == [(cuboid["category_id"], "car")]


def test_the_types_of_the_sdk_accept_it(tmp_path: Path) -> None:
    typing = pytest.importorskip("segments.typing", reason="pip install 'upvl[segments-ai]'")
    write(labelled_drive(), "segments-ai", tmp_path)
    parsed = typing.PointcloudSequenceCuboidLabelAttributes(**label(tmp_path, "bend-1"))
    assert [len(frame.annotations) for frame in parsed.frames] == [5] * 6
    sample = json.loads((tmp_path / "bend-1.sample.json").read_text())
    typing.PointcloudSequenceSampleAttributes(**sample)
    typing.TaskAttributes(**json.loads((tmp_path / "task_attributes.json").read_text()))


def test_where_3d_rotation_is_off_the_yaw_alone_gives_the_heading(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(drive, "segments-ai", tmp_path)
    content = label(tmp_path, "bend-1")
    for frame in content["frames"]:
        for cuboid in frame["annotations"]:
            del cuboid["rotation"]
    (tmp_path / "bend-1.label.json").write_text(json.dumps(content))
    boxes = read("segments-ai", tmp_path, drive)
    boxes = boxes[np.lexsort([boxes.track_id, boxes.frame])]
    np.testing.assert_allclose(boxes.heading_rad, drive.boxes.heading_rad, atol=1e-9)


def test_a_release_is_read_as_it_is_downloaded(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(drive, "segments-ai", tmp_path / "out")
    attributes = label(tmp_path / "out", "bend-1")
    task = json.loads((tmp_path / "out" / "task_attributes.json").read_text())
    attributes["frames"][0]["annotations"][0] |= {"track_id": 900, "attributes": {"score": ""}}
    samples = [
        {"name": "bend-1", "labels": {"ground-truth": {"label_status": "LABELED", "attributes": attributes}}},
        {"name": "another", "labels": {"ground-truth": None}},
    ]
    dataset = {"name": "d", "task_attributes": task, "samples": samples}
    (tmp_path / "release").mkdir()
    (tmp_path / "release" / "v1.json").write_text(json.dumps({"name": "v1", "dataset": dataset}))
    boxes = read("segments-ai", tmp_path / "release", drive)
    assert len(boxes) == len(drive.boxes) and 900 in boxes.track_id
    assert boxes.score[boxes.track_id == 900].tolist() == [1.0]


def test_a_category_that_is_not_listed_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "segments-ai", tmp_path)
    content = label(tmp_path)
    content["frames"][0]["annotations"][0]["category_id"] = 5
    (tmp_path / "one.label.json").write_text(json.dumps(content))
    with pytest.raises(BadInput, match="is of category 5, which task_attributes.json does not list"):
        read("segments-ai", tmp_path, drive_of_one_car())


def test_a_label_of_another_length_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "segments-ai", tmp_path)
    (tmp_path / "one.label.json").write_text(json.dumps({"frames": []}))
    with pytest.raises(BadInput, match="has 0 frames; drive one has 1"):
        read("segments-ai", tmp_path, drive_of_one_car())


def test_names_of_categories_are_needed(tmp_path: Path) -> None:
    write(drive_of_one_car(), "segments-ai", tmp_path)
    (tmp_path / "task_attributes.json").unlink()
    with pytest.raises(
        BadInput, match="task_attributes.json is missing; expected the names of the categories"
    ):
        read("segments-ai", tmp_path, drive_of_one_car())
