"""Scenes of nuScenes: axes, units, times, which picture belongs to which sweep, and what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from datasets.contract import check_dataset, check_labels
from datasets.nuscenes import nuscenes_tables
from datasets.nuscenes.nuscenes_tables import (
    FIRST_US,
    Tables,
    position_m,
    write_lyft,
    write_nuscenes,
    write_t4,
)
from upvl_cli.datasets.nuscenes.dataset import NuScenes
from upvl_cli.datasets.nuscenes.drive import NuScenesDrive
from upvl_cli.datasets.nuscenes.labels import NuScenesLabels
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project


@pytest.fixture
def tables(tmp_path: Path) -> Tables:
    return write_nuscenes(tmp_path)


def opened(tables: Tables) -> NuScenesDrive:
    dataset = NuScenes(tables.root)
    return dataset.open(dataset.segments[0])


@pytest.mark.parametrize("write", [write_nuscenes, write_lyft, write_t4])
def test_the_contract_of_datasets(write, tmp_path: Path) -> None:  # noqa: ANN001
    tables = write(tmp_path)
    dataset = NuScenes(tmp_path)
    check_dataset(dataset)
    check_labels(NuScenesLabels(dataset), opened(tables))


def test_frames_are_all_sweeps_of_the_lidar_in_nanoseconds(tables: Tables) -> None:
    drive = opened(tables)
    assert [frame.index for frame in drive.frames] == list(range(13))
    assert [frame.time_ns for frame in drive.frames] == [(FIRST_US + 50_000 * k) * 1000 for k in range(13)]
    assert drive.ground_z_m == 0


def test_points_are_in_ego_axes_without_the_car(tables: Tables) -> None:
    points = opened(tables).points(2)
    truth = np.concatenate([nuscenes_tables.WALL - [1.0, 0, 0], nuscenes_tables.BEHIND])
    np.testing.assert_allclose(points.xyz_ego_m, truth, atol=1e-5)
    np.testing.assert_allclose(points.intensity, np.r_[np.arange(80), 84] * 3 / 255, rtol=1e-6)


def test_poses_are_those_of_the_sweeps(tables: Tables) -> None:
    pose = opened(tables).world_from_ego
    assert pose is not None
    truth = [position_m(FIRST_US + 50_000 * k) for k in range(13)]
    np.testing.assert_allclose(pose[:, :3, 3], truth, atol=1e-6)
    np.testing.assert_allclose(pose[0, :3, :3], nuscenes_tables.HEADING.as_matrix(), atol=1e-12)


def test_a_place_is_seen_where_the_picture_has_it(tables: Tables) -> None:
    (camera,) = opened(tables).cameras
    # 12 m ahead of the camera, 2 m to the left and 1 m below: 10 px left of the middle, 5 px down.
    pixel, _, is_seen = project(camera, (nuscenes_tables.CAMERA_M + [12, 2, -1])[None])
    assert is_seen.all()
    np.testing.assert_allclose(pixel[0], [nuscenes_tables.CX - 10, nuscenes_tables.CY + 5], atol=1e-9)


def test_a_picture_belongs_to_the_turn_in_which_it_was_taken(tables: Tables) -> None:
    """Pictures at -35, 48, 131, ... ms: at 12 Hz, so that eight of thirteen sweeps have one."""
    drive = opened(tables)
    found = {frame.index: drive.image(frame.index, "CAM_FRONT") for frame in drive.frames}
    after_ms = {
        index: round((image.time_ns - drive.frames[index].time_ns) / 1e6)
        for index, image in found.items()
        if image is not None
    }
    # Sweep 10 is a key frame: of the pictures 35 and 37 ms before its end the first was labelled with it.
    assert after_ms == {0: -35, 1: -2, 3: -19, 5: -36, 6: -3, 8: -20, 10: -35, 11: -4}


def test_without_the_sweeps_folder_the_key_frames_are_read(tables: Tables) -> None:
    shutil.rmtree(tables.root / "sweeps")
    drive = opened(tables)
    assert [frame.index for frame in drive.frames] == [0, 10]
    assert drive.skipped == {"sweep without file": 11, "CAM_FRONT picture without file": 7}
    assert all(drive.image(index, "CAM_FRONT") is not None for index in (0, 10))
    assert NuScenesLabels(NuScenes(tables.root)).frames("scene-0001").tolist() == [0, 10]


def test_a_sweep_without_pose_is_left_out(tables: Tables) -> None:
    tables.rows["ego_pose"] = [row for row in tables.rows["ego_pose"] if row["token"] != "scene-0001-lidar4"]
    tables.write()
    drive = opened(tables)
    assert 4 not in [frame.index for frame in drive.frames]
    assert drive.skipped == {"sweep without pose": 1}


def test_the_folder_of_the_tables_will_do_and_small_versions_give_way(tmp_path: Path) -> None:
    write_nuscenes(tmp_path, "v1.0-mini")
    assert NuScenes(tmp_path / "v1.0-mini").segments == ("scene-0001",)
    write_nuscenes(tmp_path, "v1.0-trainval", scenes=2)
    dataset = NuScenes(tmp_path)
    assert dataset.segments == ("scene-0001", "scene-0002")
    assert dataset.scene("scene-0001").tables.folder.name == "v1.0-trainval"
    with pytest.raises(
        BadInput, match=r"has no tables of nuScenes; expected <root>/v1.0-trainval/scene.json"
    ):
        NuScenes(tmp_path / "samples")


def test_two_scenes_of_one_name_are_refused(tmp_path: Path) -> None:
    tables = write_nuscenes(tmp_path)
    tables.add("scene", token="another", name="scene-0001")
    tables.write()
    with pytest.raises(BadInput, match="two scenes scene-0001"):
        NuScenes(tmp_path)


def test_lyft(tmp_path: Path) -> None:
    drive = opened(write_lyft(tmp_path))
    assert drive.kind == "lyft"
    assert drive.frames[0].time_ns == FIRST_US * 1000 + 250
    # Of the car only what is within 1 m of the LiDAR is dropped.
    assert len(drive.points(0)) == 83
    assert drive.image(0, "CAM_FRONT") is not None
    labels = NuScenesLabels(NuScenes(tmp_path)).labels("scene-0001")
    first = labels[labels.frame == 0]
    assert sorted(zip(first.class_name.tolist(), first.type.tolist(), strict=True)) == [
        ("bicycle", 0), ("bicycle", 4), ("car", 1), ("trafficcone", 0),
    ]  # fmt: skip


def test_t4(tmp_path: Path) -> None:
    drive = opened(write_t4(tmp_path))
    assert drive.name == "project_dataset" and drive.kind == "t4"
    np.testing.assert_allclose(drive.points(0).xyz_ego_m[:80], nuscenes_tables.WALL, atol=1e-5)
    assert len(drive.points(0)) == 85, "the recording is without the car already"
    np.testing.assert_allclose(drive.cameras[0].distortion, [-0.1, 0.01, 0.001, 0.002, 0])
    assert drive.skipped == {"LIDAR_CONCAT file that is marked as not valid": 1}
    write_t4(tmp_path, "other")
    assert NuScenes(tmp_path).segments == ("project_dataset", "project_other")


# ---- labels


def test_labels_of_key_frames(tables: Tables) -> None:
    labels = NuScenesLabels(NuScenes(tables.root)).labels("scene-0001")
    first = labels[labels.frame == 0]
    by_object = {
        name.removeprefix("scene-0001-"): place for place, name in enumerate(first.object_id.tolist())
    }
    car = by_object["car"]
    away = nuscenes_tables.HEADING.inv().apply([20.0, 10.0, 0.8])
    np.testing.assert_allclose(first.center_m[car], away, atol=1e-9)
    np.testing.assert_allclose(first.size_lwh_m[car], [4.5, 1.9, 1.6])
    np.testing.assert_allclose(np.degrees(first.heading_rad[car]), 140)
    assert {name: first.type[place] for name, place in by_object.items()} == {
        "car": 1, "cyclist": 4, "bicycle": 0, "cone": 0,
    }  # fmt: skip
    assert (first.num_points == 7).all()
    speed = np.linalg.norm(labels.velocity_mps, axis=1)
    np.testing.assert_allclose(speed[labels.object_id == "scene-0001-cyclist"], 4, atol=1e-6)
    np.testing.assert_allclose(speed[labels.object_id == "scene-0001-car"], 0, atol=1e-6)


def test_between_key_frames_boxes_are_on_a_line_and_turn_the_short_way(tables: Tables) -> None:
    source = NuScenesLabels(NuScenes(tables.root))
    assert source.frames("scene-0001").tolist() == list(range(11))
    labels = source.labels("scene-0001")
    between = labels[labels.frame == 5]
    assert between.object_id.tolist() == [f"scene-0001-{name}" for name in ("car", "cyclist", "bicycle")]
    # Half way from 170 to 190 degrees, in the axes of a car that heads for 30.
    np.testing.assert_allclose(np.degrees(between.heading_rad[0]), 150, atol=1e-6)
    position = position_m(FIRST_US + 250_000)
    away = nuscenes_tables.HEADING.inv().apply([411.0, 1120.0, 0.9] - position)
    np.testing.assert_allclose(between.center_m[1], away, atol=1e-6)
    assert (between.num_points == 0).all(), "counted, as the data set gives none"


def test_a_test_split_has_no_labels(tables: Tables) -> None:
    source = NuScenesLabels(NuScenes(tables.root))
    for change in ([], None):
        path = tables.folder / "sample_annotation.json"
        path.write_text("[]") if change == [] else path.unlink()
        for read in (source.labels, source.frames):
            with pytest.raises(BadInput, match="has no label"):
                read("scene-0001")


# ---- what is refused


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        ("sample_data", {"filename": "../../etc/passwd"}, "expected the relative path of a file below"),
        ("sample_data", {"filename": "samples/../../x"}, "expected the relative path of a file below"),
        ("sample_data", {"filename": "/etc/passwd"}, "expected the relative path of a file below"),
        (
            "sample_data",
            {"filename": "samples/x\ny"},
            "names 'samples/x\\ny', expected the relative path of a file",
        ),
        ("sensor", {"channel": "LIDAR\nTOP"}, "channel of row 's-lidar' is 'LIDAR\\nTOP', expected a name"),
        (
            "sample_data",
            {"timestamp": "soon"},
            "timestamp of row 'scene-0001-lidar0' is 'soon', expected a number",
        ),
        ("sample_data", {"calibrated_sensor_token": "x"}, "has no row 'x', which sample_data.json names"),
        ("sample_data", {"timestamp": FIRST_US + 50_000}, "later than frame 0, expected ascending times"),
        ("ego_pose", {"rotation": [0.5, 0, 0, 0]}, "is a quaternion of length 0.5, expected 1"),
        ("ego_pose", {"token": 3}, "row 0 has no text token"),
        ("calibrated_sensor", {"translation": [1e3, 0, 0]}, "moves by 1e+03 m, expected at most 100 m"),
        ("scene", {"name": "a/b"}, "a drive's name holds letters"),
    ],
)
def test_what_tables_may_not_hold(
    tables: Tables, table: str, change: dict[str, object], message: str
) -> None:
    tables.rows[table][0].update(change)
    tables.write()
    with pytest.raises(BadInput) as failure:
        opened(tables)
    assert message in str(failure.value)


@pytest.mark.parametrize("name", ["a" * 5000, "none.pcd.bin"])
def test_a_file_that_cannot_be_there_is_counted(tables: Tables, name: str) -> None:
    tables.rows["sample_data"][2]["filename"] = f"sweeps/LIDAR_TOP/{name}"
    tables.write()
    assert opened(tables).skipped == {"sweep without file": 1}


def test_two_calibrations_of_one_sensor_in_a_scene_are_refused(tables: Tables) -> None:
    tables.rows["calibrated_sensor"].append({**tables.rows["calibrated_sensor"][0], "token": "second"})
    tables.rows["sample_data"][3]["calibrated_sensor_token"] = "second"
    tables.write()
    with pytest.raises(BadInput, match="LIDAR_TOP has two calibrations in scene-0001"):
        opened(tables)


def test_rows_of_another_width_are_named(tables: Tables) -> None:
    turn = np.linspace(0, 60, 4000)
    kitti = np.column_stack([20 * np.cos(turn), 20 * np.sin(turn), turn / 30, np.full(4000, 0.3)]).astype(
        "<f4"
    )
    kitti.tofile(opened(tables).sweeps[0].path)
    with pytest.raises(BadInput, match=r"holds 4 columns of float32 .* expected 5 columns of float32"):
        opened(tables).points(0)


def test_a_cut_table_is_refused(tables: Tables) -> None:
    path = tables.folder / "sample_data.json"
    path.write_text(path.read_text()[:-300])
    with pytest.raises(BadInput, match=r"sample_data.json is no whole list of rows"):
        opened(tables)


# ---- the real sweep

# What the tables of nuScenes say of this scene (scene-0061, log n015-2018-07-24-11-22-45+0800).
REAL_LIDAR = {
    "translation": [0.943713, 0.0, 1.84023],
    "rotation": [0.70779551, -0.00649224, 0.01064621, -0.70630731],
}
REAL_FRONT = {
    "translation": [1.70079118, 0.01594563, 1.51095764],
    "rotation": [0.49980154, -0.50303162, 0.49977981, -0.49737084],
    "camera_intrinsic": [[1266.41720305, 0, 816.26701974], [0, 1266.41720305, 491.50706579], [0, 0, 1]],
}


def write_real(data: Path, root: Path) -> Tables:
    """Tables of the one sweep and its front picture, with links to the real files."""
    tables = write_nuscenes(root)
    for name in ("sample_data", "ego_pose", "sample", "sample_annotation"):
        tables.rows[name] = []
    tables.rows["calibrated_sensor"][0].update(REAL_LIDAR)
    tables.rows["calibrated_sensor"][1].update(REAL_FRONT)
    tables.add("sample", token="key", timestamp=1532402927647951, scene_token="t-scene-0001")
    for path in sorted(data.iterdir()):
        _, channel, rest = path.name.split("__")
        folder = tables.root / "samples" / channel
        folder.mkdir(parents=True, exist_ok=True)
        (folder / path.name).symlink_to(path)
        if channel in ("LIDAR_TOP", "CAM_FRONT"):
            mount = f"scene-0001-m-{'lidar' if channel == 'LIDAR_TOP' else 'camera'}"
            size = {"width": 1600, "height": 900} if channel == "CAM_FRONT" else {}
            name, time_us = f"samples/{channel}/{path.name}", int(rest.partition(".")[0])
            nuscenes_tables.add_file(tables, channel, name, time_us, "key", True, mount=mount, **size)
    tables.write()
    return tables


@pytest.mark.real
def test_the_real_sweep(shared: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="expected the relative path of a file below"):
        opened(write_real(shared / "data/nuscenes_real", tmp_path / "links"))
    tables = write_real(shared / "data/nuscenes_real", tmp_path / "copies")
    for path in (tables.root / "samples").rglob("n015-2018*"):
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content)
    check_dataset(NuScenes(tables.root))
    drive = opened(tables)
    points = drive.points(0)
    xyz = points.xyz_ego_m
    assert 25_000 < len(points) < 34_688
    assert 0.9 < points.intensity.max() <= 1
    # The road is at 0 in the axes of nuScenes.
    near = (np.hypot(xyz[:, 0], xyz[:, 1]) < 12) & (np.abs(xyz[:, 2]) < 0.3)
    assert abs(np.median(xyz[near, 2])) < 0.1
    # The nearest point that is left lies off the car.
    on_car = (xyz[:, 0] > -0.6) & (xyz[:, 0] < 3.4) & (np.abs(xyz[:, 1]) < 0.86)
    assert not on_car.any()
    image = drive.image(0, "CAM_FRONT")
    assert image is not None and image.rgb.shape == (900, 1600, 3)
    assert round((image.time_ns - drive.frames[0].time_ns) / 1e6) == -35


def test_tables_may_begin_with_a_byte_order_mark(tables: Tables) -> None:
    for path in tables.folder.iterdir():
        path.write_text("\ufeff" + path.read_text(), encoding="utf-8")
    assert len(opened(tables).frames) == 13


def test_a_description_in_any_language_moves_no_row(tables: Tables) -> None:
    """The file is indexed by bytes, of which a letter may have several."""
    tables.rows["ego_pose"].insert(
        0, {"token": "x", "note": "über 北京 🚗" * 50, "nested": {"token": "scene-0001-lidar3"}}
    )
    (tables.folder / "ego_pose.json").write_text(
        json.dumps(tables.rows["ego_pose"], ensure_ascii=False), "utf-8"
    )
    pose = opened(tables).world_from_ego
    assert pose is not None
    np.testing.assert_allclose(pose[3, :3, 3], position_m(FIRST_US + 150_000), atol=1e-6)
