"""Xtreme1: one car by hand, the folders of its upload, and what it gives back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import PointDrive, drive_of_one_car, read, write
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportDrive
from upvl_cli.geometry.se3 import apply

RESULT = Path("scene_one/result/0000000007.json")


def test_a_car_ahead_that_heads_to_the_left(tmp_path: Path) -> None:
    told = write(drive_of_one_car(), "xtreme1", tmp_path)
    assert told == {"velocities, for which the format has no place": 1}
    (entry,) = json.loads((tmp_path / RESULT).read_text())["objects"]
    assert [entry[name] for name in ("type", "className", "modelClass", "trackId", "trackName")] == [
        "3D_BOX",
        "car",
        "car",
        "12",
        "12",
    ]
    assert entry["modelConfidence"] == 0.75
    contour = entry["contour"]
    assert contour["center3D"] == {"x": 10.0, "y": 2.0, "z": 0.5}
    assert contour["size3D"] == {"x": 4.0, "y": 2.0, "z": 1.5}
    assert contour["rotation3D"] == {"x": 0.0, "y": 0.0, "z": np.pi / 2}
    assert contour["pointN"] == 33


def test_a_frame_without_boxes_has_no_result_as_the_upload_refuses_it(tmp_path: Path) -> None:
    drive = labelled_drive(frames=3)
    write(drive.with_boxes(drive.boxes[drive.boxes.frame != 5]), "xtreme1", tmp_path)
    names = [path.stem for path in sorted((tmp_path / "scene_bend-1" / "result").iterdir())]
    assert names == ["0000000003", "0000000007"]
    assert np.unique(read("xtreme1", tmp_path, drive).frame).tolist() == [3, 7]


def test_the_folders_of_an_upload(tmp_path: Path) -> None:
    drive = drive_of_one_car()
    drive = ExportDrive(
        drive.name, drive.frames, drive.world_from_ego, drive.cameras, drive.boxes, PointDrive()
    )
    write(drive, "xtreme1", tmp_path, with_data=True)
    own = tmp_path / "scene_one"
    assert sorted(path.name for path in own.iterdir()) == [
        "camera_config",
        "camera_image_0",
        "lidar_point_cloud_0",
        "result",
    ]
    assert {path.stem for path in own.rglob("*.*")} == {"0000000007"}  # equal names in all folders
    (config,) = json.loads((own / "camera_config" / "0000000007.json").read_text())
    assert config["camera_internal"] == {"fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    # Row by row: a point 10 m ahead of the ego is 8.5 m before the camera, 1.1 m below its axis, 0.2 m to its right.
    seen = apply(np.reshape(config["camera_external"], (4, 4)), np.array([[10.0, 0, 0.5]]))
    np.testing.assert_allclose(seen, [[0.2, 1.1, 8.5]], atol=1e-12)


def returned(**changes: Any) -> list[dict[str, Any]]:
    contour = {
        "size3D": {"x": 4, "y": 2, "z": 1.5},
        "center3D": {"x": 1, "y": 2, "z": 3},
        "rotation3D": {"x": 0, "y": 0, "z": -1},
    }
    box = {
        "type": "3D_BOX",
        "className": "car",
        "trackId": "-COOq29Lf0S8XAvD",
        "trackName": "2",
        "contour": contour,
    }
    flat = {"type": "2D_RECT", "className": "car", "trackId": "-COOq29Lf0S8XAvD", "contour": {"points": []}}
    return [{"version": "1.0", "objects": [flat, box | changes]}, {"sourceName": "none", "objects": None}]


def test_an_export_of_xtreme1_lists_sources_and_has_ids_of_its_own(tmp_path: Path) -> None:
    own = tmp_path / "one" / "result"
    own.mkdir(parents=True)
    (own / "0000000007.json").write_text(json.dumps(returned(modelConfidence=None)))
    boxes = read("xtreme1", tmp_path, drive_of_one_car())
    assert (
        boxes.track_id.tolist() == [0] and boxes.score.tolist() == [1.0] and boxes.num_points.tolist() == [-1]
    )
    np.testing.assert_allclose(boxes.to_rows(), [[1, 2, 3, 4, 2, 1.5, -1]])


def test_a_class_that_the_ontology_has_not_comes_back_as_that_of_the_model(tmp_path: Path) -> None:
    own = tmp_path / "scene_one" / "result"
    own.mkdir(parents=True)
    (own / "0000000007.json").write_text(
        json.dumps(returned(className=None, modelClass="fire truck", trackId=None))
    )
    boxes = read("xtreme1", tmp_path, drive_of_one_car())
    assert boxes.class_name.tolist() == ["fire truck"] and boxes.track_id.tolist() == [2]


def test_a_box_without_a_class_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "scene_one" / "result"
    own.mkdir(parents=True)
    (own / "0000000007.json").write_text(json.dumps(returned(className=None)))
    with pytest.raises(BadInput, match=r"\[0\], objects\[1\] has no 'className'; expected one"):
        read("xtreme1", tmp_path, drive_of_one_car())
