"""Waymo's human boxes, the same from v2 and v1, and the zones without any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from datasets.contract import check_labels
from tiny_waymo import SEGMENT, tiny_segment, v2_columns, write_component, write_v1, write_v2
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.labels import UnlabelledZones
from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.datasets.waymo.labels import WaymoLabels
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Boxes

FORMATS = {"v2": write_v2, "v1": write_v1}


@pytest.fixture(params=list(FORMATS))
def root(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    FORMATS[request.param](tmp_path, tiny_segment())
    return tmp_path


def test_the_contract_of_labels(root: Path) -> None:
    source = label_source("waymo", root, Waymo(root))
    check_labels(source, Waymo(root).open(SEGMENT))


def test_boxes_carry_all_that_waymo_gives(root: Path) -> None:
    labels = WaymoLabels(root).labels(SEGMENT)
    assert labels.frame.tolist() == [0, 0, 1, 2, 2]
    car, sign = labels[labels.object_id == "car"], labels[labels.object_id == "sign"]
    np.testing.assert_array_equal(car.center_m, [[12, 3, 0.8], [13, 3, 0.8], [14, 3, 0.8]])
    np.testing.assert_array_equal(car.size_lwh_m, [[4.5, 2, 1.6]] * 3)
    assert (car.heading_rad == 0.3).all() and (sign.heading_rad == -1.5).all()
    assert set(car.class_name) == {"Vehicle"} and set(sign.class_name) == {"Sign"}
    assert set(car.type) == {1} and set(sign.type) == {3}
    assert set(car.num_points) == {40} and set(car.difficulty) == {2} and set(sign.difficulty) == {0}


def test_velocities_turn_from_the_world_into_the_axes_of_the_car(root: Path) -> None:
    frames = tiny_segment()
    labels = WaymoLabels(root).labels(SEGMENT)
    car = labels[labels.object_id == "car"]
    for frame, velocity in zip(frames, car.velocity_mps, strict=True):
        np.testing.assert_allclose(frame.pose[:3, :3] @ velocity, [3, 4, 0], atol=1e-12)
    assert np.isnan(labels.velocity_mps[labels.object_id == "sign"]).all()


def test_every_frame_is_labelled_also_one_without_a_box(tmp_path: Path) -> None:
    frames = tiny_segment()
    frames[1].boxes = []
    for name, write in FORMATS.items():
        write(tmp_path / name, frames)
        assert WaymoLabels(tmp_path / name).frames(SEGMENT).tolist() == [0, 1, 2]


def test_a_segment_without_labels_says_so(tmp_path: Path) -> None:
    frames = tiny_segment()
    write_v2(tmp_path / "v2", frames, without=("lidar_box",))
    for frame in frames:
        frame.boxes = []
    write_v1(tmp_path / "v1", frames)
    for name in FORMATS:
        with pytest.raises(BadInput, match="test split are not public"):
            WaymoLabels(tmp_path / name).frames(SEGMENT)


def around(places: Array) -> Boxes:
    """A box of 10 cm around each place."""
    return Boxes(places, np.full((len(places), 3), 0.1), np.zeros(len(places)))


def test_boxes_with_a_point_of_a_zone_without_labels_are_unlabelled(root: Path) -> None:
    source = WaymoLabels(root)
    assert isinstance(source, UnlabelledZones)
    item = Waymo(root).open(SEGMENT).returns(1)[0]
    found = source.unlabelled(SEGMENT, 1, around(item.xyz_ego_m))
    assert found[item.in_no_label_zone].all()
    assert 0 < found.sum() < len(found)
    assert not source.unlabelled(SEGMENT, 1, around(np.array([[0.0, 0, 500]]))).any()
    assert source.unlabelled(SEGMENT, 1, around(np.zeros((0, 3)))).shape == (0,)


def test_boxes_in_a_polygon_of_v1_are_unlabelled(tmp_path: Path) -> None:
    frames = tiny_segment(1)
    # An L in the axes of the car, whose notch is no part of it.
    corners = np.array([[200, 0], [240, 0], [240, 10], [210, 10], [210, 40], [200, 40]], float)
    world = np.c_[corners, np.zeros(6), np.ones(6)] @ frames[0].pose.T
    write_v1(tmp_path, frames, zones=[world[:, :2]])
    places = np.array([[205, 30, 0], [230, 5, 0], [230, 30, 0], [190, 5, 0]], float)
    found = WaymoLabels(tmp_path).unlabelled(SEGMENT, 0, around(places))
    assert found.tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("type", [7] * 5, "a type or a difficulty that Waymo has not"),
        ("box.size.x", [0.0] * 5, "a box without size"),
        ("box.center.y", [np.nan] * 5, "a box without size, or farther"),
        ("box.center.y", [1e6] * 5, "farther than 10000 m"),
        ("speed.x", [1e9] * 5, "a speed"),
        ("box.heading", ["a"] * 5, "expected float64"),
    ],
)
def test_boxes_that_cannot_be_are_refused(
    column: str, values: list[float], message: str, tmp_path: Path
) -> None:
    columns = v2_columns(tiny_segment())
    columns["lidar_box"][f"[LiDARBoxComponent].{column}"] = pa.array(values)
    write_v2(tmp_path, tiny_segment())
    write_component(tmp_path, "lidar_box", columns["lidar_box"])
    with pytest.raises(BadInput, match=message):
        WaymoLabels(tmp_path).labels(SEGMENT)


def test_two_boxes_of_an_object_in_a_frame_are_refused(tmp_path: Path) -> None:
    frames = tiny_segment(1)
    frames[0].boxes *= 2
    for name, write in FORMATS.items():
        write(tmp_path / name, frames)
        with pytest.raises(BadInput, match="second ones of an object"):
            WaymoLabels(tmp_path / name).labels(SEGMENT)


@pytest.mark.real
def test_the_real_boxes_of_v1(shared: Path) -> None:
    source = WaymoLabels(shared / "data/waymo_real/v1")
    labels = source.labels("pvps_data_one_frame")
    assert len(labels) == 75 and set(labels.type) == {1, 2, 3, 4}
    assert set(labels.difficulty) == {0, 2} and labels.num_points.max() == 11442
    speed_mps = np.linalg.norm(labels.velocity_mps, axis=1)
    assert np.isfinite(speed_mps).all() and 1 < speed_mps.max() < 30
    road = (labels.center_m[:, 2] - labels.size_lwh_m[:, 2] / 2)[labels.type == 1]
    assert abs(np.median(road)) < 0.5  # the origin of the car's axes is on the road
