"""OpenLABEL: one car by hand, the official schema, and what other tools write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import drive_of_one_car, read, write
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes
from upvl_cli.geometry.se3 import apply
from upvl_cli.types import concat


def content_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "one.openlabel.json").read_text())["openlabel"]


def test_a_car_ahead_that_heads_to_the_left(tmp_path: Path) -> None:
    write(drive_of_one_car(), "openlabel", tmp_path / "out")
    content = content_of(tmp_path / "out")
    half = np.sqrt(0.5)  # a quarter of a turn about z: x y z w = 0 0 sin 45 cos 45
    (cuboid,) = content["frames"]["7"]["objects"]["12"]["object_data"]["cuboid"]
    np.testing.assert_allclose(cuboid["val"], [10, 2, 0.5, 0, 0, half, half, 4, 2, 1.5], atol=1e-12)
    assert cuboid["coordinate_system"] == "ego"
    assert cuboid["attributes"]["num"] == [{"name": "score", "val": 0.75}, {"name": "num_points", "val": 33}]
    assert cuboid["attributes"]["vec"][0]["val"] == [0.0, 3.0, 0.0]
    assert content["objects"]["12"]["type"] == "car"
    assert content["objects"]["12"]["frame_intervals"] == [{"frame_start": 7, "frame_end": 7}]
    properties = content["frames"]["7"]["frame_properties"]
    assert properties["timestamp"] == "1500000000.123456789"
    matrix = properties["transforms"]["ego_to_world"]["transform_src_to_dst"]["matrix4x4"]
    # 10 m ahead of an ego that looks along the world's y, 2 m to its left: the world's -x.
    assert apply(np.reshape(matrix, (4, 4)), np.array([[10.0, 2, 0.5]])).tolist() == [[98.0, 210.0, 5.5]]


def test_a_heading_of_60_degrees_is_half_of_it_in_the_quaternion(tmp_path: Path) -> None:
    write(drive_of_one_car(heading_rad=[np.pi / 3]), "openlabel", tmp_path / "out")
    (cuboid,) = content_of(tmp_path / "out")["frames"]["7"]["objects"]["12"]["object_data"]["cuboid"]
    np.testing.assert_allclose(cuboid["val"][3:7], [0, 0, 0.5, np.sqrt(0.75)], atol=1e-12)


def test_the_official_schema_and_checker_find_nothing(tmp_path: Path) -> None:
    checker = pytest.importorskip("openlabel_checker", reason="pip install 'upvl[openlabel]'")
    empty = labelled_drive("empty").with_boxes(concat([], ExportBoxes))
    for drive in (labelled_drive(), drive_of_one_car(), empty):
        write(drive, "openlabel", tmp_path / drive.name)
        report = checker.check_file(str(tmp_path / drive.name / f"{drive.name}.openlabel.json"))
        assert [outcome.issues for outcome in report.outcomes if outcome.issues] == []
        assert all(outcome.status == "completed" for outcome in report.outcomes)


def changed(folder: Path, **cuboid: Any) -> Path:
    """The file with other values of its cuboid; None removes one."""
    write(drive_of_one_car(), "openlabel", folder)
    content = content_of(folder)
    (entry,) = content["frames"]["7"]["objects"]["12"]["object_data"]["cuboid"]
    for name, value in cuboid.items():
        entry.pop(name) if value is None else entry.update({name: value})
    (folder / "one.openlabel.json").write_text(json.dumps({"openlabel": content}))
    return folder


def test_nine_values_are_angles_about_x_y_and_z(tmp_path: Path) -> None:
    folder = changed(tmp_path / "out", val=[10, 2, 0.5, 0, 0, 0.3, 4, 2, 1.5])
    assert read("openlabel", folder, drive_of_one_car()).heading_rad == pytest.approx([0.3])


def test_world_coordinates_are_brought_into_ego_axes(tmp_path: Path) -> None:
    # Along the world's x is to the right of an ego that looks along y.
    folder = changed(tmp_path / "out", val=[98, 210, 5.5, 0, 0, 0, 1, 4, 2, 1.5], coordinate_system="world")
    boxes = read("openlabel", folder, drive_of_one_car())
    np.testing.assert_allclose(boxes.center_m, [[10, 2, 0.5]], atol=1e-9)
    assert boxes.heading_rad == pytest.approx([-np.pi / 2])


def test_axes_that_nobody_knows_are_refused(tmp_path: Path) -> None:
    folder = changed(tmp_path / "out", coordinate_system="LIDAR")
    with pytest.raises(BadInput, match="is in the axes 'LIDAR'; expected 'ego' or 'world'"):
        read("openlabel", folder, drive_of_one_car())


def test_a_tool_may_leave_out_what_it_does_not_know(tmp_path: Path) -> None:
    boxes = read(
        "openlabel", changed(tmp_path / "out", attributes=None, coordinate_system=None), drive_of_one_car()
    )
    assert boxes.score.tolist() == [1.0] and boxes.num_points.tolist() == [-1]
    assert np.isnan(boxes.velocity_mps).all() and boxes.class_name.tolist() == ["car"]


def test_new_objects_have_uuids(tmp_path: Path) -> None:
    write(drive_of_one_car(), "openlabel", tmp_path / "out")
    content = content_of(tmp_path / "out")
    uid = "4d1a6f0e-9d8f-4c51-b2f0-6b8f6d0a6f11"
    content["objects"][uid] = {"name": "new", "type": "bus"}
    value = [1, 2, 0, 0, 0, 0, 1, 12, 3, 3]
    content["frames"]["7"]["objects"][uid] = {"object_data": {"cuboid": [{"name": "shape", "val": value}]}}
    (tmp_path / "out" / "one.json").write_text(json.dumps({"openlabel": content}))  # renamed by a tool
    (tmp_path / "out" / "one.openlabel.json").unlink()
    boxes = read("openlabel", tmp_path / "out", drive_of_one_car())
    assert boxes.track_id.tolist() == [12, 13]  # a new number above those that are known
    assert boxes.class_name.tolist() == ["car", "bus"]


def test_a_cuboid_outside_of_frames_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "openlabel", tmp_path / "out")
    content = content_of(tmp_path / "out")
    content["objects"]["12"] |= content["frames"]["7"]["objects"]["12"]
    (tmp_path / "out" / "one.openlabel.json").write_text(json.dumps({"openlabel": content}))
    with pytest.raises(BadInput, match="is of no frame; expected cuboids within frames"):
        read("openlabel", tmp_path / "out", drive_of_one_car())


def test_a_frame_that_the_drive_has_not_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "openlabel", tmp_path / "out")
    path = tmp_path / "out" / "one.openlabel.json"
    path.write_text(path.read_text().replace('"frames":{"7"', '"frames":{"8"'))
    with pytest.raises(BadInput, match="drive one has no frame 8; expected 7 to 7"):
        read("openlabel", tmp_path / "out", drive_of_one_car())
