"""Boxes in Waymo's two forms, read by its official messages and classes, and by the reader of the data set."""

from __future__ import annotations

import importlib
import importlib.util
import shutil
import sys
import types
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from export.labelled_drives import labelled_drive
from tiny_waymo import SEGMENT, tiny_segment, write_v2
from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.datasets.waymo.labels import WaymoLabels
from upvl_cli.errors import BadInput
from upvl_cli.export import waymo_wire as wire
from upvl_cli.export.drive import ExportBoxes, ExportDrive, boxes_of_rows
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.se3 import wrap_angle

OBJECTS, COMPONENTS = export_format("waymo"), export_format("waymo-parquet")
NO_PROTOS = "needs the official messages: pip install --no-deps waymo-open-dataset-tf-2-12-0"
BOX = "[LiDARBoxComponent]."


def write(folder: Path, name: str, *drives: ExportDrive) -> dict[str, int]:
    return export(drives, export_format(name), folder, ExportOptions(), Counter())


def official(name: str) -> Any:
    pytest.importorskip("google.protobuf", reason="needs protobuf")
    return pytest.importorskip(f"waymo_open_dataset.protos.{name}", reason=NO_PROTOS)


def official_component(name: str) -> Any:
    """A module of Waymo's v2 classes; its package itself would load TensorFlow and Dask."""
    spec = importlib.util.find_spec("waymo_open_dataset")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip(NO_PROTOS)
    package = types.ModuleType("waymo_open_dataset.v2")
    package.__path__ = [f"{spec.submodule_search_locations[0]}/v2"]
    sys.modules.setdefault("waymo_open_dataset.v2", package)
    return importlib.import_module(f"waymo_open_dataset.v2.perception.{name}")


# ---- the message Objects


def test_the_official_message_says_the_same(tmp_path: Path) -> None:
    metrics = official("metrics_pb2")
    drive = labelled_drive()
    write(tmp_path / "out", "waymo", drive)
    objects = metrics.Objects.FromString((tmp_path / "out" / "objects.bin").read_bytes())
    own, velocity = drive.boxes, drive.velocity_world_mps()
    assert len(objects.objects) == len(own)
    for i, item in enumerate(objects.objects):
        label, box = item.object, item.object.box
        assert (item.context_name, item.frame_timestamp_micros) == (
            "bend-1",
            drive.times_ns[drive.places[i]] // 1000,
        )
        assert label.id == str(own.track_id[i])
        assert [box.center_x, box.center_y, box.center_z] == own.center_m[i].tolist()
        assert [box.length, box.width, box.height] == own.size_lwh_m[i].tolist()
        assert box.heading == own.heading_rad[i]
        assert item.score == np.float32(own.score[i])
        assert label.num_lidar_points_in_box == own.num_points[i]
        speed = label.metadata
        np.testing.assert_array_equal([speed.speed_x, speed.speed_y, speed.speed_z], velocity[i])
    assert [item.object.type for item in objects.objects[:5]] == [1, 2, 4, 0, 1]
    # A field that the message does not know would come back beside its own.
    again = metrics.Objects()
    again.CopyFrom(objects)
    again.DiscardUnknownFields()
    assert again.SerializeToString() == objects.SerializeToString()


def test_a_whole_submission_comes_back(tmp_path: Path) -> None:
    submission = official("submission_pb2").Submission()
    drive = labelled_drive()
    write(tmp_path / "out", "waymo", drive)
    path = tmp_path / "out" / "objects.bin"
    submission.task = submission.TRACKING_3D
    submission.account_name = "somebody@example.org"
    submission.inference_results.ParseFromString(path.read_bytes())
    path.write_bytes(submission.SerializeToString())
    back = read_back(OBJECTS, tmp_path / "out", {"bend-1": drive})["bend-1"]
    np.testing.assert_array_equal(back.center_m, drive.boxes.center_m)
    assert back.class_name.tolist() == drive.boxes.class_name.tolist()


def test_objects_without_ids_are_tracks_of_their_own(tmp_path: Path) -> None:
    drive = labelled_drive(frames=1)
    box = b"".join(wire.double(field, value) for field, value in ((1, 5.0), (4, 2.0), (5, 4.0), (6, 1.5)))
    item = wire.message(1, wire.message(1, box) + wire.whole_number(3, 1))
    item += wire.text(4, "bend-1") + wire.whole_number(5, drive.frames[0].time_ns // 1000)
    (tmp_path / "objects.bin").write_bytes(wire.message(1, item) * 2)
    back = read_back(OBJECTS, tmp_path, {"bend-1": drive})["bend-1"]
    assert back.to_rows().tolist() == [[5, 0, 0, 4, 2, 1.5, 0]] * 2
    assert len(set(back.track_id.tolist())) == 2
    assert back.class_name.tolist() == ["vehicle"] * 2
    assert (back.score == 1).all() and (back.num_points == -1).all() and np.isnan(back.velocity_mps).all()


def test_boxes_of_which_little_is_known(tmp_path: Path) -> None:
    drive = labelled_drive()
    unknown = np.full((len(drive.boxes), 3), np.nan)
    columns = {name: getattr(drive.boxes, name) for name in drive.boxes.__dataclass_fields__}
    columns |= {"velocity_mps": unknown, "num_points": np.full(len(unknown), -1)}
    for name, fmt in (("waymo", OBJECTS), ("waymo-parquet", COMPONENTS)):
        write(tmp_path / name, name, drive.with_boxes(ExportBoxes(**columns)))
        back = read_back(fmt, tmp_path / name, {"bend-1": drive})["bend-1"]
        assert np.isnan(back.velocity_mps).all() and (back.num_points == -1).all()
    table = pq.read_table(tmp_path / "waymo-parquet" / "lidar_box" / "bend-1.parquet")
    for column in ("num_lidar_points_in_box", "speed.x", "speed.z"):  # empty cells, as Waymo has them
        assert table[f"{BOX}{column}"].null_count == len(drive.boxes)


def test_a_class_that_is_no_text_is_refused(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", "waymo-parquet", drive)
    path = tmp_path / "out" / "lidar_box" / "bend-1.parquet"
    table = pq.read_table(path)
    damaged = pa.array([b"C\xf9clist"] * 30).view(pa.string())
    pq.write_table(
        table.set_column(table.column_names.index("upvl.class_name"), "upvl.class_name", damaged), path
    )
    with pytest.raises(BadInput, match="column upvl.class_name cannot be read"):
        read_back(COMPONENTS, tmp_path / "out", {"bend-1": drive})


@pytest.mark.parametrize("name", ["waymo", "waymo-parquet"])
def test_classes_that_waymo_has_not_are_told(name: str, tmp_path: Path) -> None:
    lost = write(tmp_path / "out", name, labelled_drive())
    found = {reason.partition(", the class in")[0]: count for reason, count in lost.items()}
    assert found == {
        "boxes of class 'other', which Waymo has not: of type Unknown": 6,
        "boxes of class 'fire_truck', which Waymo has not: of type Vehicle": 6,
    }


# ---- the components of v2


def test_the_official_classes_read_the_components(tmp_path: Path) -> None:
    component = official_component("box").LiDARBoxComponent
    pose = official_component("pose").VehiclePoseComponent
    drive = labelled_drive()
    write(tmp_path / "out", "waymo-parquet", drive)
    table = pq.read_table(tmp_path / "out" / "lidar_box" / "bend-1.parquet")
    schema = component.schema()
    assert table.select(schema.names).schema.equals(schema)
    own = drive.boxes
    for i, row in enumerate(table.to_pylist()):
        label = component.from_dict(row)
        assert label.key.laser_object_id == str(own.track_id[i])
        center, size = label.box.center, label.box.size
        assert [center.x, center.y, center.z] == own.center_m[i].tolist()
        assert [size.x, size.y, size.z] == own.size_lwh_m[i].tolist()
        assert label.box.heading == own.heading_rad[i]
    poses = pq.read_table(tmp_path / "out" / "vehicle_pose" / "bend-1.parquet")
    assert poses.schema.equals(pose.schema())
    transform = pose.from_dict(poses.to_pylist()[2]).world_from_vehicle.transform
    np.testing.assert_array_equal(np.reshape(transform, (4, 4)), drive.world_from_ego[2])


def test_the_reader_of_the_data_set_gives_the_same(tmp_path: Path) -> None:
    """Boxes of a tiny segment of Waymo's own form, exported beside its other components."""
    write_v2(tmp_path / "set", tiny_segment())
    source = Waymo(tmp_path / "set").open(SEGMENT)
    assert source.world_from_ego is not None
    index = [frame.index for frame in source.frames]
    boxes = boxes_of_rows(
        np.array([[8.0 + i, -3.0, 0.5, 4.5, 1.9, 1.6, 0.3 * i] for i in range(len(index))]),
        frame=index,
        track_id=[4] * len(index),
        class_name=["vehicle"] * len(index),
        velocity_mps=np.array([[2.0, 0.5, 0.1]] * len(index)),
        num_points=[7] * len(index),
    )
    drive = ExportDrive(SEGMENT, source.frames, source.world_from_ego, source.cameras, boxes, source)
    write(tmp_path / "out", "waymo-parquet", drive)
    shutil.copytree(tmp_path / "out" / "lidar_box", tmp_path / "set" / "lidar_box", dirs_exist_ok=True)
    labels = WaymoLabels(tmp_path / "set").labels(SEGMENT)
    assert labels.frame.tolist() == index
    assert labels.object_id.tolist() == ["4"] * len(index)
    assert labels.class_name.tolist() == ["Vehicle"] * len(index)
    np.testing.assert_allclose(labels.center_m, boxes.center_m)
    np.testing.assert_allclose(wrap_angle(labels.heading_rad - boxes.heading_rad), 0, atol=1e-12)
    np.testing.assert_allclose(labels.velocity_mps, boxes.velocity_mps)
    assert labels.num_points.tolist() == [7] * len(index)


@pytest.mark.parametrize(
    "column, values, message",
    [
        ("key.frame_timestamp_micros", [1] * 30, "has no frame at 1000 ns"),
        ("key.frame_timestamp_micros", [2**63 - 1] * 30, "before 2096"),
        (f"{BOX}box.size.x", [-1.0] * 30, "has no size or no place"),
        (f"{BOX}box.center.x", ["x"] * 30, "expected float64"),
        (f"{BOX}type", [None] * 30, "empty cells"),
        ("key.laser_object_id", ["a"] * 30, "two boxes of track"),
        ("upvl.class_name", [1] * 30, None),
    ],
)
def test_what_is_wrong_with_a_component_is_named(
    column: str, values: list[object], message: str | None, tmp_path: Path
) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", "waymo-parquet", drive)
    path = tmp_path / "out" / "lidar_box" / "bend-1.parquet"
    table = pq.read_table(path)
    changed = table.set_column(table.column_names.index(column), column, pa.array(values))
    pq.write_table(changed, path)
    if message is None:
        assert len(read_back(COMPONENTS, tmp_path / "out", {"bend-1": drive})["bend-1"]) == 30
        return
    with pytest.raises(BadInput, match=message) as failure:
        read_back(COMPONENTS, tmp_path / "out", {"bend-1": drive})
    assert "\n" not in str(failure.value)
