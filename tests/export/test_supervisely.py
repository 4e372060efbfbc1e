"""Supervisely's point clouds: one car by hand, what CVAT's library reads, and what CVAT gives back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import drive_of_one_car, read, write
from upvl_cli.errors import BadInput

ANNOTATION = Path("one/ds0/ann/0000000007.pcd.json")


def annotation(folder: Path) -> dict[str, Any]:
    return json.loads((folder / ANNOTATION).read_text())


def test_a_car_ahead_that_heads_to_the_left(tmp_path: Path) -> None:
    write(drive_of_one_car(), "supervisely", tmp_path)
    content = annotation(tmp_path)
    (described,), (figure,) = content["objects"], content["figures"]
    assert described["classTitle"] == "car" and figure["objectKey"] == described["key"]
    assert figure["geometry"] == {
        "position": {"x": 10.0, "y": 2.0, "z": 0.5},
        "rotation": {"x": 0.0, "y": 0.0, "z": np.pi / 2},
        "dimensions": {"x": 4.0, "y": 2.0, "z": 1.5},
    }
    assert figure["keyframe"] is True  # what makes CVAT join the figures of an object to a track
    assert {tag["name"]: tag["value"] for tag in described["tags"]} == {
        "upvl_track": 12,
        "score": 0.75,
        "velocity_x_mps": 0.0,
        "velocity_y_mps": 3.0,
        "velocity_z_mps": 0.0,
        "num_points": 33,
    }
    keys = json.loads((tmp_path / "one" / "key_id_map.json").read_text())
    assert keys["objects"] == {described["key"]: 12} and keys["videos"] == {content["key"]: 0}


def test_an_object_has_one_key_in_all_frames(tmp_path: Path) -> None:
    write(labelled_drive(), "supervisely", tmp_path)
    paths = sorted((tmp_path / "bend-1" / "ds0" / "ann").iterdir())
    keys = [{entry["key"] for entry in json.loads(path.read_text())["objects"]} for path in paths]
    assert len(paths) == 6 and len(keys[0]) == 5 and all(found == keys[0] for found in keys)


def test_the_library_of_cvat_reads_it(tmp_path: Path) -> None:
    dm = pytest.importorskip("datumaro", reason="pip install datumaro, in an environment of its own")
    write(drive_of_one_car(), "supervisely", tmp_path)
    (item,) = dm.Dataset.import_from(str(tmp_path / "one"), "sly_pointcloud")
    (cuboid,) = item.annotations
    assert item.id == "0000000007"
    assert [list(values) for values in (cuboid.position, cuboid.rotation, cuboid.scale)] == [
        [10.0, 2.0, 0.5],
        [0.0, 0.0, 1.57],
        [4.0, 2.0, 1.5],
    ]
    assert cuboid.attributes["track_id"] == 12 and cuboid.attributes["score"] == 0.75


def test_what_the_library_of_cvat_writes_again_is_read(tmp_path: Path) -> None:
    dm = pytest.importorskip("datumaro", reason="pip install datumaro, in an environment of its own")
    drive = labelled_drive()
    write(drive, "supervisely", tmp_path / "out")
    dataset = dm.Dataset.import_from(str(tmp_path / "out" / "bend-1"), "sly_pointcloud")
    dataset.export(str(tmp_path / "back" / "bend-1"), "sly_pointcloud", allow_undeclared_attrs=True)
    boxes = read("supervisely", tmp_path / "back", drive)
    boxes = boxes[np.lexsort([boxes.track_id, boxes.frame])]
    assert boxes.track_id.tolist() == drive.boxes.track_id.tolist()
    np.testing.assert_allclose(boxes.to_rows(), drive.boxes.to_rows(), atol=0.00501)  # two decimals
    np.testing.assert_allclose(boxes.score, drive.boxes.score)


def returned(folder: Path, **tags: Any) -> Path:
    """What CVAT exports: keys and numbers of its own, values as text, a name of its own for a new object."""
    write(drive_of_one_car(), "supervisely", folder)
    content = annotation(folder)
    content["objects"][0]["tags"] = [
        {"key": "k", "name": name, "value": value} for name, value in tags.items()
    ]
    content["objects"].append({"key": "new", "classTitle": "bus", "tags": [], "labelerLogin": "somebody"})
    geometry = {"position": {"x": 1, "y": 2, "z": 3}, "rotation": {"x": 0, "y": 0, "z": -1}}
    geometry["dimensions"] = {"x": 12, "y": 3, "z": 3.5}
    figure = {"key": "f", "objectKey": "new", "geometryType": "cuboid_3d", "geometry": geometry}
    content["figures"].append(figure)
    (folder / ANNOTATION).write_text(json.dumps(content))
    keys = {"objects": {content["objects"][0]["key"]: 0, "new": 12}}
    (folder / "one" / "key_id_map.json").write_text(json.dumps(keys))
    return folder


def test_our_number_comes_back_as_a_tag_and_a_new_object_is_not_taken_for_ours(tmp_path: Path) -> None:
    folder = returned(tmp_path / "out", upvl_track="12", score="0.5", num_points="")
    boxes = read("supervisely", folder, drive_of_one_car())
    assert boxes.track_id.tolist() == [12, 13]  # CVAT's own 12 is another object
    assert boxes.class_name.tolist() == ["car", "bus"]
    assert boxes.score.tolist() == [0.5, 1.0] and boxes.num_points.tolist() == [-1, -1]
    np.testing.assert_allclose(boxes.to_rows()[1], [1, 2, 3, 12, 3, 3.5, -1])


def test_without_tags_and_numbers_figures_of_an_object_stay_together(tmp_path: Path) -> None:
    write(labelled_drive(), "supervisely", tmp_path)
    for path in (tmp_path / "bend-1" / "ds0" / "ann").iterdir():
        content = json.loads(path.read_text())
        for entry in content["objects"]:
            del entry["tags"]
        path.write_text(json.dumps(content))
    (tmp_path / "bend-1" / "key_id_map.json").unlink()
    boxes = read("supervisely", tmp_path, labelled_drive())
    assert np.unique(boxes.track_id, return_counts=True)[1].tolist() == [6] * 5


def test_a_figure_of_no_object_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "supervisely", tmp_path)
    content = annotation(tmp_path) | {"objects": []}
    (tmp_path / ANNOTATION).write_text(json.dumps(content))
    with pytest.raises(
        BadInput, match=r"figures\[0\] is of an object that 0000000007.pcd.json does not list"
    ):
        read("supervisely", tmp_path, drive_of_one_car())
