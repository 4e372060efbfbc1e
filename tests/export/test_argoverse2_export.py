"""Logs of Argoverse 2, opened by av2 and by the reader of the data set."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.feather
import pytest

from export.drives_with_data import drive_with_data
from export.labelled_drives import labelled_drive
from upvl_cli.datasets.argoverse2.dataset import Argoverse2
from upvl_cli.datasets.argoverse2.labels import ArgoverseLabels
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportDrive
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import wrap_angle

FORMAT = export_format("argoverse2")
NO_AV2 = "needs av2: pip install 'upvl[argoverse2]'"


def write(folder: Path, *drives: ExportDrive, with_data: bool = False) -> dict[str, int]:
    return export(drives, FORMAT, folder, ExportOptions(with_data=with_data), Counter())


def test_av2_reads_the_cuboids(tmp_path: Path) -> None:
    cuboids = pytest.importorskip("av2.structures.cuboid", reason=NO_AV2)
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    found = cuboids.CuboidList.from_feather(tmp_path / "out" / "bend-1" / "annotations.feather")
    own = drive.boxes
    assert len(found) == len(own)
    assert [cuboid.category for cuboid in found.cuboids[:4]] == [
        "REGULAR_VEHICLE",
        "PEDESTRIAN",
        "BICYCLIST",
        "other",
    ]
    for i, cuboid in enumerate(found.cuboids):
        np.testing.assert_allclose(cuboid.xyz_center_m, own.center_m[i], atol=1e-9)
        np.testing.assert_allclose(
            [cuboid.length_m, cuboid.width_m, cuboid.height_m], own.size_lwh_m[i], atol=1e-9
        )
        nose = cuboid.dst_SE3_object.rotation[:, 0]
        np.testing.assert_allclose(
            nose, [np.cos(own.heading_rad[i]), np.sin(own.heading_rad[i]), 0], atol=1e-9
        )
        assert cuboid.timestamp_ns == drive.times_ns[drive.places[i]]


def test_av2_moves_a_car_forward_through_the_city(tmp_path: Path) -> None:
    cuboids = pytest.importorskip("av2.structures.cuboid", reason=NO_AV2)
    from av2.utils.io import read_city_SE3_ego

    drive = labelled_drive()
    write(tmp_path / "out", drive)
    log = tmp_path / "out" / "bend-1"
    poses = read_city_SE3_ego(log)
    found = cuboids.CuboidList.from_feather(log / "annotations.feather").cuboids
    for track in range(5):
        own = found[track::5]
        city = [poses[int(cuboid.timestamp_ns)].compose(cuboid.dst_SE3_object) for cuboid in own]
        way = city[-1].translation - city[0].translation
        assert city[0].rotation[:, 0] @ way > 0.99 * np.linalg.norm(way)


def test_av2_projects_with_the_cameras(tmp_path: Path) -> None:
    pinhole = pytest.importorskip("av2.geometry.camera.pinhole_camera", reason=NO_AV2)
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    camera = pinhole.PinholeCamera.from_feather(tmp_path / "out" / "bend-1", "front")
    points = np.array([[10.0, 1.0, 0.5], [20.0, -4.0, 2.0]])
    pixels, _, _ = camera.project_ego_to_img(points)
    expected, *_ = project(drive.cameras[0], points)
    np.testing.assert_allclose(pixels[:, :2], expected, atol=1e-6)


def test_the_reader_of_the_data_set_gives_the_same(tmp_path: Path) -> None:
    drive = drive_with_data()
    write(tmp_path / "out", drive, with_data=True)
    dataset = Argoverse2(tmp_path / "out")
    labels = ArgoverseLabels(dataset).labels("bend-1")
    own = drive.boxes
    order = np.lexsort([own.track_id.astype(str), own.frame])
    assert labels.object_id.tolist() == own.track_id[order].astype(str).tolist()
    np.testing.assert_allclose(labels.center_m, own.center_m[order])
    np.testing.assert_allclose(wrap_angle(labels.heading_rad - own.heading_rad[order]), 0, atol=1e-9)
    assert labels.num_points.tolist() == own.num_points[order].tolist()
    np.testing.assert_allclose(labels.velocity_mps, own.velocity_mps[order], atol=1e-3)
    log = dataset.open("bend-1")
    np.testing.assert_allclose(log.world_from_ego, drive.world_from_ego, atol=1e-9)
    assert [camera.name for camera in log.cameras] == ["front", "left"]
    points = log.points(log.frames[0].index)
    assert len(points.xyz_ego_m) == 1 + 11 * (0 + 1 + 2 + 3 + 4)


def test_a_file_of_av2_without_further_columns_comes_back(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    path = tmp_path / "out" / "bend-1" / "annotations.feather"
    table = pyarrow.feather.read_table(path).drop_columns(
        ["score", "velocity_x_mps", "velocity_y_mps", "velocity_z_mps", "num_interior_pts"]
    )
    pyarrow.feather.write_feather(table, str(path))
    back = read_back(FORMAT, tmp_path / "out", {"bend-1": drive})["bend-1"]
    assert (back.score == 1).all() and np.isnan(back.velocity_mps).all() and (back.num_points == -1).all()


def test_classes_that_av2_does_not_know_are_told(tmp_path: Path) -> None:
    lost = write(tmp_path / "out", labelled_drive())
    assert lost["boxes of class 'fire truck', which is none of the format: written by that name"] == 6


@pytest.mark.parametrize(
    "column, values, message",
    [
        ("qw", [9.0] * 30, "quaternion of length"),
        ("timestamp_ns", [7] * 30, "has no frame at 7 ns"),
        ("timestamp_ns", [2**63 - 1] * 30, "before 2096"),
        ("length_m", ["long"] * 30, "expected float64"),
        ("tx_m", [None] * 30, "empty cells"),
        ("tx_m", [np.inf] * 30, "has no size or no place"),
        ("track_uuid", ["a"] * 30, "two boxes of track"),
        ("category", [1.5] * 30, "expected string"),
    ],
)
def test_what_is_wrong_with_a_log_is_named(
    column: str, values: list[object], message: str, tmp_path: Path
) -> None:
    drive = labelled_drive()
    write(tmp_path / "out", drive)
    path = tmp_path / "out" / "bend-1" / "annotations.feather"
    table = pyarrow.feather.read_table(path)
    place = table.column_names.index(column)
    changed = table.set_column(place, column, pyarrow.array(values))
    pyarrow.feather.write_feather(changed, str(path))
    with pytest.raises(BadInput, match=message) as failure:
        read_back(FORMAT, tmp_path / "out", {"bend-1": drive})
    assert "\n" not in str(failure.value)
