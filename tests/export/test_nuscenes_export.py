"""Tables of nuScenes, opened by its own devkit and by the reader of the data set; and what tools make of them."""

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
from upvl_cli.datasets.nuscenes.labels import NuScenesLabels
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.nuscenes_names import instance_token, track_of
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.se3 import apply, compose, from_yaw, rotate, wrap_angle

FORMAT = export_format("nuscenes")
VERSION = "v1.0-upvl"
NO_DEVKIT = "needs nuscenes-devkit: pip install 'upvl[nuscenes]'"


def write(folder: Path, *drives: ExportDrive, with_data: bool = False) -> dict[str, int]:
    return export(drives, FORMAT, folder, ExportOptions(with_data=with_data), Counter())


def devkit(folder: Path) -> Any:
    module = pytest.importorskip("nuscenes.nuscenes", reason=NO_DEVKIT)
    return module.NuScenes(version=VERSION, dataroot=str(folder), verbose=False)


def with_boxes(drive: ExportDrive, **changed: object) -> ExportDrive:
    columns = {name: getattr(drive.boxes, name) for name in drive.boxes.__dataclass_fields__}
    return drive.with_boxes(ExportBoxes(**columns | changed))


def edit(folder: Path, table: str, change: Any) -> None:
    """Change the rows of a table in place."""
    path = folder / VERSION / f"{table}.json"
    rows = json.loads(path.read_text())
    for row in rows:
        change(row)
    path.write_text(json.dumps(rows))


# ---- the devkit of nuScenes


def test_the_devkit_sees_each_box_where_the_car_sees_it(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive, labelled_drive("bend-2", frames=2))
    tables = devkit(tmp_path / "out")
    assert [scene["name"] for scene in tables.scene] == ["bend-1", "bend-2"]
    token = tables.scene[0]["first_sample_token"]
    seen = 0
    for frame in drive.frames:
        sample = tables.get("sample", token)
        assert sample["timestamp"] == frame.time_ns // 1000
        _, boxes, _ = tables.get_sample_data(
            sample["data"]["LIDAR_TOP"]
        )  # in the axes of the points: the ego's
        own = drive.boxes[drive.boxes.frame == frame.index]
        assert len(boxes) == len(own)
        for box, i in zip(boxes, range(len(own)), strict=True):
            np.testing.assert_allclose(box.center, own.center_m[i], atol=1e-6)
            np.testing.assert_allclose(box.wlh, own.size_lwh_m[i, [1, 0, 2]], atol=1e-9)
            nose = box.rotation_matrix[:, 0]
            np.testing.assert_allclose(
                nose, [np.cos(own.heading_rad[i]), np.sin(own.heading_rad[i]), 0], atol=1e-6
            )
            record = tables.get("sample_annotation", box.token)
            assert record["num_lidar_pts"] == own.num_points[i]
            assert record["instance_token"] == instance_token("bend-1", own.track_id[i])
            seen += 1
        token = sample["next"]
    assert token == "" and seen == len(drive.boxes)


def test_the_devkit_finds_the_speed_of_each_track(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    tables = devkit(tmp_path / "out")
    world = drive.velocity_world_mps()
    for instance in tables.instance:
        track = int(track_of(instance["token"], "bend-1"))
        own = np.flatnonzero(drive.boxes.track_id == track)
        assert instance["nbr_annotations"] == len(own)
        token, walked = instance["first_annotation_token"], 0
        while token:
            np.testing.assert_allclose(tables.box_velocity(token), world[own[walked]], atol=1e-3)
            nose = tables.get_box(token).rotation_matrix[:, 0]
            assert nose @ world[own[walked]] > 0.99 * np.linalg.norm(world[own[walked]])
            last, token, walked = token, tables.get("sample_annotation", token)["next"], walked + 1
        assert last == instance["last_annotation_token"] and walked == len(own)


def test_the_devkit_lists_categories_and_attributes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "out", labelled_drive())
    tables = devkit(tmp_path / "out")
    tables.list_categories()
    tables.list_attributes()
    tables.list_scenes()
    printed = capsys.readouterr().out
    for name in ("vehicle.car", "human.pedestrian.adult", "vehicle.bicycle", "fire_truck", "bend-1"):
        assert name in printed
    names = Counter(
        tables.get("attribute", token)["name"]
        for record in tables.sample_annotation
        for token in record["attribute_tokens"]
    )
    assert names == {"vehicle.moving": 6, "pedestrian.moving": 6, "cycle.with_rider": 6}


def test_the_devkit_reads_points_and_pictures(tmp_path: Path) -> None:
    drive = drive_with_data()
    write(tmp_path / "out", drive, with_data=True)
    tables = devkit(tmp_path / "out")
    from nuscenes.utils.data_classes import LidarPointCloud
    from nuscenes.utils.geometry_utils import points_in_box
    from PIL import Image

    for sample in tables.sample:
        path, boxes, _ = tables.get_sample_data(sample["data"]["LIDAR_TOP"])
        points = LidarPointCloud.from_file(path).points[:3]
        for box in boxes:
            record = tables.get("sample_annotation", box.token)
            assert points_in_box(box, points).sum() == record["num_lidar_pts"]
        path, seen, intrinsic = tables.get_sample_data(sample["data"]["front"])
        assert Image.open(path).size == (640, 480)
        np.testing.assert_array_equal(intrinsic, drive.cameras[0].intrinsic)
    assert sum("left" in sample["data"] for sample in tables.sample) == 5  # one picture is missing


# ---- the reader of the data set


def test_the_reader_of_the_data_set_gives_the_same_labels(tmp_path: Path) -> None:
    drive = drive_with_data()
    write(tmp_path / "out", drive, with_data=True)
    dataset = NuScenesFolder(tmp_path / "out")
    labels = NuScenesLabels(dataset).labels("bend-1")
    own = drive.boxes
    assert labels.frame.tolist() == np.repeat(np.arange(6), 5).tolist()
    assert labels.object_id.tolist() == [instance_token("bend-1", track) for track in own.track_id]
    np.testing.assert_allclose(labels.center_m, own.center_m, atol=1e-6)
    np.testing.assert_allclose(labels.size_lwh_m, own.size_lwh_m)
    # That reader takes boxes as level in the world: on this slope its headings are off by a tenth of a degree.
    np.testing.assert_allclose(wrap_angle(labels.heading_rad - own.heading_rad), 0, atol=np.deg2rad(0.2))
    cameras = dataset.open("bend-1").cameras
    assert [camera.name for camera in cameras] == ["front", "left"]
    np.testing.assert_allclose(cameras[1].ego_from_camera, drive.cameras[1].ego_from_camera, atol=1e-9)


# ---- the way back


def test_boxes_stay_on_the_points_when_the_workspace_has_refined_its_poses(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    shifted = replace(
        drive, world_from_ego=compose(from_yaw(0.1, np.array([3.0, -2.0, 1.0])), drive.world_from_ego)
    )
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": shifted})["bend-1"]
    np.testing.assert_allclose(back.center_m, drive.boxes.center_m, atol=1e-6)
    (tmp_path / "out" / VERSION / "ego_pose.json").unlink()  # then those of the workspace count
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": shifted})["bend-1"]
    assert np.linalg.norm(back.center_m - drive.boxes.center_m, axis=1).min() > 1


def test_a_box_that_a_tool_has_tilted_keeps_its_heading(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)

    def tilt(row: dict[str, Any]) -> None:
        from scipy.spatial.transform import Rotation

        w, x, y, z = row["rotation"]
        turned = Rotation.from_quat([x, y, z, w]) * Rotation.from_euler("y", 0.2)
        x, y, z, w = turned.as_quat()
        row["rotation"] = [w, x, y, z]

    edit(tmp_path / "out", "sample_annotation", tilt)
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    np.testing.assert_allclose(wrap_angle(back.heading_rad - drive.boxes.heading_rad), 0, atol=1e-6)


def test_tables_of_another_tool_come_back(tmp_path: Path) -> None:
    """Without what upvl adds: no velocity, other tokens for the tracks, another name of the version."""
    drive = labelled_drive()
    write(tmp_path / "out", drive)

    def plain(row: dict[str, Any]) -> None:
        row.pop("velocity")
        row["instance_token"] = f"mine-{row['instance_token']}"

    edit(tmp_path / "out", "sample_annotation", plain)
    edit(tmp_path / "out", "instance", lambda row: row.update(token=f"mine-{row['token']}"))
    (tmp_path / "out" / VERSION).rename(tmp_path / "out" / "v1.0-trainval")
    (tmp_path / "out" / "upvl.json").unlink()
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert np.isnan(back.velocity_mps).all()
    pairs = set(zip(drive.boxes.track_id.tolist(), back.track_id.tolist(), strict=True))
    assert len(pairs) == len(set(drive.boxes.track_id.tolist()))
    assert back.class_name.tolist()[:4] == ["vehicle", "pedestrian", "cyclist", "other"]


def test_a_track_of_two_classes_is_written_in_that_of_most_of_its_boxes(tmp_path: Path) -> None:
    drive = labelled_drive()
    names = drive.boxes.class_name.astype("U20")
    names[0] = "other"
    lost = write(tmp_path / "out", with_boxes(drive, class_name=names))
    assert lost["boxes of another class than most boxes of their track: written in that of the track"] == 1
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert back.class_name[0] == "vehicle"


def test_who_stands_and_who_parks(tmp_path: Path) -> None:
    """The car moves in the first frame alone, the pedestrian never; of the cyclist nobody knows."""
    drive = labelled_drive()
    velocity = drive.boxes.velocity_mps.copy()
    velocity[5:] = 0
    velocity[1::5] = 0
    velocity[2::5] = np.nan
    write(tmp_path / "out", with_boxes(drive, velocity_mps=velocity))
    folder = tmp_path / "out" / VERSION
    names = {row["token"]: row["name"] for row in json.loads((folder / "attribute.json").read_text())}
    rows = json.loads((folder / "sample_annotation.json").read_text())
    found = [[names[token] for token in row["attribute_tokens"]] for row in rows]
    assert found[:5] == [["vehicle.moving"], ["pedestrian.standing"], ["cycle.with_rider"], [], []]
    assert found[5:8] == [["vehicle.stopped"], ["pedestrian.standing"], ["cycle.with_rider"]]
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert np.isnan(back.velocity_mps[2::5]).all()


@pytest.mark.parametrize(
    "table, change, message",
    [
        ("sample_annotation", {"size": [1, 2]}, "expected a list of 3 numbers"),
        ("sample_annotation", {"rotation": [0, 0, 0, 0]}, "quaternion of length 0"),
        ("sample_annotation", {"instance_token": "x"}, "instance.json has no row 'x'"),
        ("sample_annotation", {"translation": [1, 2, "3"]}, "expected a list of 3 numbers"),
        ("sample_annotation", {"num_lidar_pts": "many"}, "expected a number"),
        ("sample_annotation", {"size": [0, 0, 0]}, "has no size or no place"),
        ("instance", {"category_token": "x"}, "category.json lacks"),
        ("sample", {"timestamp": 5}, "has no frame at 5000 ns"),
        ("sample", {"timestamp": None}, "expected a number"),
        ("scene", {"name": "../up"}, "a drive's name holds letters"),
        ("scene", {"name": "elsewhere"}, "has no labels of a drive of this workspace"),
        ("ego_pose", {"rotation": "north"}, "expected a list of 4 numbers"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(
    table: str, change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    edit(tmp_path / "out", table, lambda row: row.update(change))
    with pytest.raises(BadInput, match=message) as failure:
        read_back(FORMAT, tmp_path / "out", {"bend-1": drive})
    assert "\n" not in str(failure.value)


def test_global_boxes_are_those_of_the_world(tmp_path: Path) -> None:
    """Without the devkit: the first box of the file, by hand."""
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    row = json.loads((tmp_path / "out" / VERSION / "sample_annotation.json").read_text())[0]
    np.testing.assert_allclose(
        row["translation"], apply(drive.world_from_ego[0], drive.boxes.center_m[:1])[0]
    )
    np.testing.assert_allclose(
        row["velocity"], rotate(drive.world_from_ego[0], drive.boxes.velocity_mps[:1])[0]
    )
