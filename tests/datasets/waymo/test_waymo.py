"""Waymo segments, v2 and v1: what tiny true ones give, and what is refused."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from datasets.contract import check_dataset
from tiny_waymo import (
    BEAMS,
    CAMERA_MOUNTS,
    INTRINSIC,
    MOUNTS,
    PICTURE_DELAY_S,
    SEGMENT,
    SHAPES,
    START_US,
    STEP_US,
    TOP,
    TinyFrame,
    record,
    tiny_segment,
    v2_columns,
    write_component,
    write_v1,
    write_v2,
)
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.datasets.waymo.calibration import LaserCalibration
from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.datasets.waymo.drive import WaymoDrive
from upvl_cli.datasets.waymo.range_images import laser_return
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project
from upvl_cli.perception.visual.pixel_source import PixelSource

FORMATS = {"v2": write_v2, "v1": write_v1}


@pytest.fixture(scope="module")
def truth() -> list[TinyFrame]:
    return tiny_segment()


@pytest.fixture(params=list(FORMATS))
def root(request: pytest.FixtureRequest, truth: list[TinyFrame], tmp_path: Path) -> Path:
    """The tiny segment in each format."""
    FORMATS[request.param](tmp_path, truth)
    return tmp_path


def open_drive(root: Path) -> WaymoDrive:
    return Waymo(root).open(SEGMENT)


# ---- what a whole segment gives


def test_the_contract_of_datasets(root: Path) -> None:
    check_dataset(dataset_family("waymo").open(root, None))


def test_frames_are_in_order_of_time_and_poses_are_theirs(root: Path, truth: list[TinyFrame]) -> None:
    drive = open_drive(root)
    assert [frame.index for frame in drive.frames] == [0, 1, 2]
    assert [frame.time_ns for frame in drive.frames] == [frame.stamp * 1000 for frame in truth]
    np.testing.assert_array_equal(drive.world_from_ego, [frame.pose for frame in truth])
    assert drive.skipped == {} and drive.ground_z_m == 0.0
    assert all(path.is_file() and "lidar_box" not in str(path) for path in drive.files)


def test_points_of_each_return_are_where_explicit_matrices_put_them(
    root: Path, truth: list[TinyFrame]
) -> None:
    drive = open_drive(root)
    for number, frame in enumerate(truth):
        returns = drive.returns(number)
        assert [(item.laser, item.return_number) for item in returns] == sorted(frame.range_images)
        for item in returns:
            image = frame.range_images[item.laser, item.return_number]
            channels = image[image[..., 0] > 0]
            np.testing.assert_allclose(
                item.xyz_ego_m, frame.xyz_ego_m[item.laser, item.return_number], atol=1e-9
            )
            np.testing.assert_array_equal(item.intensity, channels[:, 1])
            np.testing.assert_array_equal(item.elongation, channels[:, 2])
            np.testing.assert_array_equal(item.in_no_label_zone, channels[:, 3] == 1)


def test_a_sweep_is_all_returns_with_bounded_intensity(root: Path, truth: list[TinyFrame]) -> None:
    drive = open_drive(root)
    points, returns = drive.points(1), drive.returns(1)
    expected = np.concatenate([item.xyz_ego_m for item in returns])
    np.testing.assert_array_equal(points.xyz_ego_m, expected.astype(np.float32))
    np.testing.assert_array_equal(
        points.sensor, np.repeat([item.laser for item in returns], [len(item.pixel) for item in returns])
    )
    raw = np.concatenate([item.intensity for item in returns])
    assert raw.max() > 1
    np.testing.assert_allclose(points.intensity, np.tanh(raw), rtol=1e-6)
    np.testing.assert_array_equal(points.elongation, np.concatenate([item.elongation for item in returns]))


def test_pixels_are_those_of_the_data_set(root: Path, truth: list[TinyFrame]) -> None:
    drive = open_drive(root)
    assert isinstance(drive, PixelSource)
    for number, frame in enumerate(truth):
        keys = sorted(frame.range_images)
        rows = np.concatenate([frame.projections[key][frame.range_images[key][..., 0] > 0] for key in keys])
        for name, camera in (("FRONT", 1), ("SIDE_LEFT", 4)):
            found = drive.pixels(number, name)
            assert found is not None
            seen = (rows[:, 0] == camera) | (rows[:, 3] == camera)
            assert seen.any() and not seen.all()
            np.testing.assert_array_equal(np.isfinite(found).all(axis=1), seen)
            first = rows[:, 0] == camera
            np.testing.assert_array_equal(found[first], rows[first, 1:3])
            second = seen & ~first
            np.testing.assert_array_equal(found[second], rows[second, 4:6])


def test_a_known_point_is_seen_where_waymos_camera_model_puts_it(root: Path) -> None:
    front, left = open_drive(root).cameras
    assert (front.name, left.name) == ("FRONT", "SIDE_LEFT")
    assert (front.width_px, front.height_px, left.height_px) == (32, 20, 14)
    f_u, f_v, c_u, c_v, k1, k2, p1, p2, k3 = INTRINSIC
    for camera, number in ((front, 1), (left, 4)):
        x, y, z = 10.0, 0.7, 0.4  # Waymo: x along the view, y left, z up
        place = CAMERA_MOUNTS[number] @ [x, y, z, 1]
        u, v = -y / x, -z / x
        r2 = u * u + v * v
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        column = (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) * f_u + c_u
        row = (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v) * f_v + c_v
        found, _, visible = project(camera, place[None, :3])
        assert visible.all()
        # Waymo counts from the edge of the first pixel, upvl from its centre.
        np.testing.assert_allclose(found[0], [column - 0.5, row - 0.5], atol=1e-9)


def test_pictures_have_the_time_of_their_pose(root: Path, truth: list[TinyFrame]) -> None:
    image = open_drive(root).image(2, "SIDE_LEFT")
    assert image is not None
    assert image.rgb.shape == (14, 32, 3) and abs(float(image.rgb.mean()) - 160) < 3
    assert abs(image.time_ns - round((truth[2].stamp / 1e6 + PICTURE_DELAY_S) * 1e9)) < 1000


def test_a_beam_straight_ahead_hits_a_place_straight_ahead() -> None:
    calibration = LaserCalibration("FRONT", np.eye(4), -0.1, 0.1, None, "here")
    image = np.full((1, 5, 4), -1, np.float32)
    image[0, 2] = [10, 0.5, 0.1, -1]
    found = laser_return(2, 1, image, calibration, None, np.eye(4), "here")
    np.testing.assert_allclose(found.xyz_ego_m, [[10, 0, 0]], atol=1e-12)
    image[0] = [[10, 0.5, 0.1, -1], *([[-1] * 4] * 4)]  # the first column is behind, a little to the left
    found = laser_return(2, 1, image, calibration, None, np.eye(4), "here")
    angle = np.pi - np.pi / 5
    np.testing.assert_allclose(found.xyz_ego_m, [[10 * np.cos(angle), 10 * np.sin(angle), 0]], atol=1e-12)


def test_rays_without_a_return_are_no_points(tmp_path: Path, truth: list[TinyFrame]) -> None:
    frame = tiny_segment(1)[0]
    image = frame.range_images[TOP, 1]
    image[0, :, 0], image[1, :, 0] = 0, np.nan
    write_v2(tmp_path, [frame])
    found = open_drive(tmp_path).returns(0)[0]
    assert len(found.pixel) == (image[2:, :, 0] > 0).sum()


@pytest.mark.parametrize("rows_per_group", [1, 4, 1000])
@pytest.mark.parametrize("codec", ["none", "zstd"])
def test_row_groups_and_codecs_do_not_matter(
    rows_per_group: int, codec: str, tmp_path: Path, truth: list[TinyFrame]
) -> None:
    write_v2(tmp_path, truth, rows_per_group=rows_per_group, codec=codec)
    drive = open_drive(tmp_path)
    for number in (2, 0, 1):
        for item in drive.returns(number):
            np.testing.assert_allclose(
                item.xyz_ego_m, truth[number].xyz_ego_m[item.laser, item.return_number], atol=1e-9
            )


def test_other_types_are_cast(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v2(tmp_path, truth)
    columns = v2_columns(truth)
    names = {1: "FRONT", 4: "SIDE_LEFT"}
    for component in ("camera_calibration", "camera_image"):
        columns[component]["key.camera_name"] = [
            names[key] for key in columns[component]["key.camera_name"].to_pylist()
        ]
    lidar = columns["lidar"]
    lidar["key.laser_name"] = lidar["key.laser_name"].cast(pa.int64())
    shape = "[LiDARComponent].range_image_return1.shape"
    lidar[shape] = pa.array(lidar[shape].to_pylist(), pa.list_(pa.int64()))
    pose = "[VehiclePoseComponent].world_from_vehicle.transform"
    columns["vehicle_pose"][pose] = pa.array(
        columns["vehicle_pose"][pose].to_pylist(), pa.list_(pa.float32(), 16)
    )
    for component in ("camera_calibration", "camera_image", "lidar", "vehicle_pose"):
        write_component(tmp_path, component, columns[component])
    drive = open_drive(tmp_path)
    assert [camera.name for camera in drive.cameras] == ["FRONT", "SIDE_LEFT"]
    assert drive.image(0, "SIDE_LEFT") is not None
    np.testing.assert_allclose(
        drive.points(0).xyz_ego_m,
        np.concatenate([truth[0].xyz_ego_m[key] for key in sorted(truth[0].xyz_ego_m)]),
        atol=5e-3,
    )


# ---- layouts, and what is missing


def test_splits_are_found_and_v2_goes_before_v1(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v1(tmp_path / "training", truth)
    assert Waymo(tmp_path).path(SEGMENT).suffix == ".tfrecord"
    write_v2(tmp_path / "validation", truth)
    assert Waymo(tmp_path).segments == (SEGMENT,)
    assert Waymo(tmp_path).path(SEGMENT).suffix == ".parquet"
    assert Waymo(tmp_path / "training").path(SEGMENT).suffix == ".tfrecord"
    write_v2(tmp_path / "copy", truth)
    with pytest.raises(BadInput, match="have one name"):
        Waymo(tmp_path)


def test_a_folder_without_segments_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"expected <root>/vehicle_pose/<segment>.parquet"):
        Waymo(tmp_path)


def test_a_frame_without_a_sweep_is_left_out_and_counted(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v2(tmp_path, truth)
    columns = v2_columns([truth[0], truth[2]])
    for component in ("lidar", "camera_image"):
        write_component(tmp_path, component, columns[component])
    drive = open_drive(tmp_path)
    assert [frame.index for frame in drive.frames] == [0, 2]
    assert drive.skipped == {"no LiDAR sweep": 1}
    assert drive.world_from_ego is not None and len(drive.world_from_ego) == 2
    with pytest.raises(BadInput, match="has no frame 1"):
        drive.points(1)


def test_sweeps_and_pictures_without_a_pose_are_counted(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v2(tmp_path, truth)
    write_component(tmp_path, "vehicle_pose", v2_columns(truth[:2])["vehicle_pose"])
    drive = open_drive(tmp_path)
    assert len(drive.frames) == 2
    assert drive.skipped == {"LiDAR sweep without a pose": 1, "picture without a frame": 2}


@pytest.mark.parametrize("name", ["v2", "v1"])
def test_a_segment_without_sweeps_has_poses_and_pictures(
    name: str, tmp_path: Path, truth: list[TinyFrame]
) -> None:
    if name == "v2":
        write_v2(
            tmp_path, truth, without=("lidar", "lidar_calibration", "lidar_pose", "lidar_camera_projection")
        )
    else:
        write_v1(tmp_path, truth, empty=True)
    drive = open_drive(tmp_path)
    assert len(drive.frames) == 3 and drive.world_from_ego is not None
    assert drive.image(0, "FRONT") is not None
    with pytest.raises(BadInput, match="has no LiDAR sweep"):
        drive.points(0)


def test_poses_alone_open(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_component(tmp_path, "vehicle_pose", v2_columns(truth)["vehicle_pose"])
    drive = open_drive(tmp_path)
    assert len(drive.frames) == 3 and drive.cameras == ()


def test_without_projections_the_camera_model_counts(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v2(tmp_path, truth, without=("lidar_camera_projection",))
    assert open_drive(tmp_path).pixels(0, "FRONT") is None


def test_rows_of_other_segments_do_not_count(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v2(tmp_path, truth)
    columns = v2_columns(truth)["vehicle_pose"]
    columns["key.segment_context_name"] = [SEGMENT, "another", SEGMENT]
    write_component(tmp_path, "vehicle_pose", columns)
    assert len(open_drive(tmp_path).frames) == 2
    columns["key.segment_context_name"] = ["another"] * 3
    write_component(tmp_path, "vehicle_pose", columns)
    with pytest.raises(BadInput, match="holds no row of the segment"):
        open_drive(tmp_path)


# ---- what is refused


def double_rows(columns: dict[str, Any]) -> dict[str, Any]:
    return {name: pa.concat_arrays([pa.array(values), pa.array(values)]) for name, values in columns.items()}


def test_two_rows_of_one_key_are_refused(tmp_path: Path, truth: list[TinyFrame]) -> None:
    columns = v2_columns(truth)
    for component, message in (
        ("lidar", "expected one; copy"),
        ("vehicle_pose", "expected one pose a frame"),
    ):
        write_v2(tmp_path, truth)
        write_component(tmp_path, component, double_rows(columns[component]))
        with pytest.raises(BadInput, match=message):
            open_drive(tmp_path)


def test_sizes_that_are_not_those_of_the_values_are_refused(tmp_path: Path, truth: list[TinyFrame]) -> None:
    write_v2(tmp_path, truth)
    columns = v2_columns(truth)["lidar"]
    name = "[LiDARComponent].range_image_return1.shape"
    shapes = columns[name].to_pylist()
    shapes[0][0] -= 1
    columns[name] = pa.array(shapes, pa.list_(pa.int32(), 3))
    write_component(tmp_path, "lidar", columns)
    with pytest.raises(BadInput, match="hold 1224 numbers|no row lies|numbers, expected"):
        open_drive(tmp_path).points(0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.range_images[TOP, 1].__setitem__((0, 0, 0), np.inf), "range of inf m"),
        (lambda f: f.range_images[TOP, 1].__setitem__((0, 0, 0), 2e4), "no LiDAR sees"),
        (lambda f: f.pixel_poses.__setitem__((..., 3), np.nan), "no places on Earth"),
        (lambda f: f.pixel_poses.__setitem__((..., 3), 9e4), "do not fit the frame's pose"),
        (lambda f: f.pictures.__setitem__(1, b"no picture"), "not a whole JPEG"),
        (lambda f: f.pictures.__setitem__(1, f.pictures[4]), "its calibration says 32 x 20"),
    ],
)
@pytest.mark.parametrize("name", list(FORMATS))
def test_damaged_content_is_refused_in_one_line(name: str, change: Any, message: str, tmp_path: Path) -> None:
    frames = tiny_segment(1)
    change(frames[0])
    FORMATS[name](tmp_path, frames)
    drive = open_drive(tmp_path)
    with pytest.raises(BadInput, match=message) as failure:
        drive.points(0)
        drive.image(0, "FRONT")
    assert "\n" not in str(failure.value)


def test_another_number_of_beams_is_refused(
    tmp_path: Path, truth: list[TinyFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(BEAMS, TOP, np.array([-0.1, 0.1]))
    write_v2(tmp_path, truth)
    with pytest.raises(BadInput, match="has 2 beams, but its range images have 6 rows"):
        open_drive(tmp_path).points(0)


def test_a_mount_that_is_no_rotation_is_refused(
    tmp_path: Path, truth: list[TinyFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(MOUNTS, TOP, MOUNTS[TOP] * 1.01)
    write_v2(tmp_path, truth)
    with pytest.raises(BadInput, match="extrinsic of laser TOP is not a rotation"):
        open_drive(tmp_path)


@pytest.mark.parametrize(
    ("component", "name"),
    [
        ("vehicle_pose", "[VehiclePoseComponent].world_from_vehicle.transform"),
        ("lidar_calibration", "[LiDARCalibrationComponent].extrinsic.transform"),
        ("camera_calibration", "[CameraCalibrationComponent].extrinsic.transform"),
    ],
)
def test_transforms_that_are_null_are_refused(
    component: str, name: str, tmp_path: Path, truth: list[TinyFrame]
) -> None:
    write_v2(tmp_path, truth)
    columns = v2_columns(truth)[component]
    columns[name] = pa.nulls(len(columns[name]), columns[name].type)
    write_component(tmp_path, component, columns)
    with pytest.raises(BadInput, match="is empty, expected 16 numbers"):
        open_drive(tmp_path)


def test_a_record_that_is_cut_off_is_refused(tmp_path: Path, truth: list[TinyFrame]) -> None:
    path = write_v1(tmp_path, truth)
    content = path.read_bytes()
    for size, message in (
        (len(content) - 1, "is cut off"),
        (len(content) + 5, "no TFRecord begins"),
        (0, "no record"),
    ):
        path.write_bytes((content + b"12345678")[:size])
        with pytest.raises(BadInput, match=message):
            open_drive(tmp_path)


def test_a_record_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tfrecord"
    for content, message in (
        (b"", "has no time stamp"),
        (b"hello", "is damaged"),
        (b"\x10\x05", "a pose of 0 numbers"),
    ):
        path.write_bytes(record(content))
        with pytest.raises(BadInput, match=message):
            Waymo(tmp_path).open("a")


def test_two_records_of_one_time_are_refused(tmp_path: Path, truth: list[TinyFrame]) -> None:
    path = write_v1(tmp_path, truth)
    path.write_bytes(path.read_bytes() * 2)
    with pytest.raises(BadInput, match="expected one record a frame"):
        open_drive(tmp_path)


@pytest.mark.parametrize("name", list(FORMATS))
def test_a_thousand_frames_open_at_once(name: str, tmp_path: Path) -> None:
    frame = tiny_segment(1)[0]
    frames = [
        TinyFrame(
            START_US + number * STEP_US,
            frame.pose,
            frame.range_images,
            frame.projections,
            frame.pixel_poses,
            frame.pictures,
            [],
        )
        for number in range(1000)
    ]
    FORMATS[name](tmp_path, frames)
    start = time.process_time()
    drive = open_drive(tmp_path)
    assert time.process_time() - start < 1.0
    assert len(drive.frames) == 1000 and len(drive.points(999)) == len(drive.points(0)) > 50
    assert len(SHAPES) == 3


# ---- real pieces


@pytest.mark.real
def test_the_real_record_of_v1(shared: Path) -> None:
    waymo = Waymo(shared / "data/waymo_real/v1")
    drive = waymo.open(waymo.segments[0])
    assert len(drive.frames) == 1 and set(drive.source.lasers) == {1, 2, 3, 4, 5}
    sizes = {camera.name: (camera.width_px, camera.height_px) for camera in drive.cameras}
    assert sizes["FRONT"] == (1920, 1280) and sizes["SIDE_RIGHT"] == (1920, 886)
    for camera in drive.cameras:
        image = drive.image(0, camera.name)
        assert image is not None and image.rgb.shape == (camera.height_px, camera.width_px, 3)
        assert 0 < image.time_ns - drive.frames[0].time_ns < 1e8
    with pytest.raises(BadInput, match="range images are missing or empty"):
        drive.points(0)


@pytest.mark.real
def test_the_real_poses_of_v2(shared: Path) -> None:
    waymo = Waymo(shared / "data/waymo_real/v2")
    drive = waymo.open(waymo.segments[0])
    assert len(drive.frames) == 199 and drive.world_from_ego is not None
    step_m = np.linalg.norm(np.diff(drive.world_from_ego[:, :3, 3], axis=0), axis=1)
    assert step_m.max() < 3


@pytest.mark.real
def test_the_sample_that_the_official_code_reads(shared: Path) -> None:
    expected = np.load(shared / "wod/expected/points.npz")
    for root in (shared / "wod/sample", shared / "wod/sample/v1"):
        waymo = Waymo(root)
        drive = waymo.open(waymo.segments[0])
        for frame in drive.frames:
            for item in drive.returns(frame.index):
                key = f"{frame.index}/laser{item.laser}/return{item.return_number}"
                np.testing.assert_allclose(item.xyz_ego_m, expected[f"{key}/xyz"], atol=1e-9)
