"""Drives that anybody writes as Parquet tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import open_door
from datasets.contract import assert_one_line, check_dataset
from open_door import FRAMES, SEGMENT, START_NS, STEP_NS, write_open_door, write_table
from upvl_cli.datasets.parquet.dataset import ParquetDrives
from upvl_cli.datasets.parquet.drive import ParquetDrive
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_open_door(tmp_path / "drives")


def drive_of(root: Path) -> ParquetDrive:
    return ParquetDrives(root).open(SEGMENT)


def write_points(root: Path, metadata: dict[str, str] | None = None, **changes: Any) -> None:
    write_table(root / f"points/{SEGMENT}.parquet", open_door.point_columns(**changes), metadata)


@pytest.mark.parametrize("absent", ["nothing", "cameras", "images", "intensity", "world_from_ego", "sensor"])
def test_the_contract_of_datasets(absent: str, root: Path) -> None:
    """Also without pictures, poses, intensity."""
    if absent in ("cameras", "images"):
        (root / absent / f"{SEGMENT}.parquet").unlink()
    elif absent != "nothing":
        write_points(root, **{absent: None})
    check_dataset(ParquetDrives(root))


def test_what_a_drive_holds(root: Path) -> None:
    drive = drive_of(root)
    assert [frame.index for frame in drive.frames] == list(FRAMES)
    assert [frame.time_ns for frame in drive.frames] == [START_NS + STEP_NS * frame for frame in FRAMES]
    assert drive.world_from_ego is not None
    np.testing.assert_array_equal(drive.world_from_ego[2], open_door.pose(2))
    points = drive.points(FRAMES[1])
    np.testing.assert_array_equal(points.xyz_ego_m, open_door.ego_points(1))
    assert set(points.intensity.tolist()) == {0.25} and set(points.sensor.tolist()) == {2}
    assert abs(drive.ground_z_m - open_door.GROUND_Z_M) < 0.1
    image = drive.image(FRAMES[1], "front")
    assert image is not None and image.time_ns == START_NS + STEP_NS * FRAMES[1] + 2_000_000
    assert np.abs(image.rgb.reshape(-1, 3).mean(axis=0) - open_door.RED).max() < 3


def test_a_camera_looks_where_it_is_mounted(root: Path) -> None:
    (camera,) = drive_of(root).cameras
    uv_px, depth_m, inside = project(camera, np.array([[10.5, -1.0, -0.2], [10.5, 0.0, -1.2], [-5, 0, 0]]))
    np.testing.assert_allclose(depth_m[:2], 10)
    np.testing.assert_allclose(uv_px[:2], [[59.5 + 6, 29.5], [59.5, 29.5 + 6]])
    assert inside.tolist() == [True, True, False]


@pytest.mark.parametrize("row_group_size", [1, 2, 100])
def test_any_row_groups_in_any_order(row_group_size: int, root: Path) -> None:
    for folder, columns in (("points", open_door.point_columns()), ("images", open_door.image_columns())):
        path = root / folder / f"{SEGMENT}.parquet"
        write_table(path, columns, row_group_size=row_group_size, data_page_size=256)
        assert pq.ParquetFile(path).metadata.num_row_groups == -(-len(FRAMES) // row_group_size)
    drive = drive_of(root)
    for step in (2, 3, 0, 1, 3, 0):
        np.testing.assert_array_equal(drive.points(FRAMES[step]).xyz_ego_m, open_door.ego_points(step))
        image = drive.image(FRAMES[step], "front")
        assert image is not None and image.time_ns == START_NS + STEP_NS * FRAMES[step] + 2_000_000
    check_dataset(ParquetDrives(root))


def test_a_sweep_without_points(root: Path) -> None:
    """An empty list, and no list at all, in every column."""
    plain = open_door.point_columns()
    names = ("x_m", "y_m", "z_m", "intensity", "sensor")
    for cell in ([], None):
        columns = {name: pa.array([cell, *pa.array(plain[name]).to_pylist()[1:]]) for name in names}
        write_points(root, **columns)
        assert len(drive_of(root).points(FRAMES[0])) == 0
        assert len(drive_of(root).points(FRAMES[1])) > 0


def test_many_rows_in_one_row_group(tmp_path: Path) -> None:
    """More rows than are kept of a stream: forwards, far back, and forwards again."""
    count = 40
    cell = [np.full(5, row, np.float32) for row in range(count)]
    columns = {
        "frame": range(count),
        "time_ns": np.arange(count) * STEP_NS,
        "x_m": cell,
        "y_m": cell,
        "z_m": cell,
    }
    write_table(tmp_path / "points/long.parquet", columns, row_group_size=1000)
    drive = ParquetDrives(tmp_path).open("long")
    for frame in [*range(count), 3, 39, 38, 0]:
        assert drive.points(frame).xyz_ego_m.tolist() == [[frame] * 3] * 5


def test_types_of_other_writers_are_cast(root: Path) -> None:
    """Double lists, 64-bit numbers and large lists, as polars and pandas write them."""
    lists = pa.large_list(pa.float64())
    plain = open_door.point_columns()
    write_points(
        root,
        frame=pa.array(FRAMES, pa.int64()),
        world_from_ego=pa.array([open_door.pose(step).ravel() for step in range(4)], pa.list_(pa.float64())),
        **{name: pa.array(plain[name], lists) for name in ("x_m", "y_m", "z_m", "intensity")},
    )
    drive = drive_of(root)
    np.testing.assert_array_equal(drive.points(FRAMES[0]).xyz_ego_m, open_door.ego_points(0))


def test_points_without_a_place_are_dropped_and_counted(root: Path) -> None:
    plain = open_door.point_columns()
    x_m = [np.where(np.arange(len(x)) < 7, np.nan, x) for x in plain["x_m"]]
    write_points(root, x_m=x_m)
    drive = drive_of(root)
    assert len(drive.points(FRAMES[1])) == len(x_m[1]) - 7
    assert drive.skipped_points == {FRAMES[1]: {"points without a return (not a number)": 7}}


def test_points_measured_while_the_lidar_turned_are_moved_to_the_time_of_the_frame(root: Path) -> None:
    """A static world, each point stored in the ego axes of its own moment."""
    step, world = 1, open_door.world_points()
    start, here, after = (open_door.pose(number) for number in (0, step, step + 1))
    there = world @ start[:3, :3].T + start[:3, 3]
    share = np.linspace(0, 0.5, len(world))
    stored = np.empty_like(world)
    for row, part in enumerate(share):
        yaw = 0.02 * (FRAMES[step] + part * (FRAMES[step + 1] - FRAMES[step]))
        turned = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        place = here[:3, 3] + part * (after[:3, 3] - here[:3, 3])
        stored[row] = (there[row] - place) @ turned + [0, 0, open_door.GROUND_Z_M]
    interval_ns = STEP_NS * (FRAMES[step + 1] - FRAMES[step])
    plain = open_door.point_columns()
    columns = {name: [cell.astype(float) for cell in plain[name]] for name in ("x_m", "y_m", "z_m")}
    for axis, name in enumerate(columns):
        columns[name][step] = stored[:, axis]
    offsets = [np.zeros(len(world), np.int32) for _ in FRAMES]
    offsets[step] = (share * interval_ns).astype(np.int32)
    write_points(root, {"motion_compensated": "false"}, **columns, time_offset_ns=offsets)
    found = drive_of(root).points(FRAMES[step])
    np.testing.assert_allclose(found.xyz_ego_m, open_door.ego_points(step), atol=2e-3)
    assert np.abs(stored - open_door.ego_points(step)).max() > 0.5
    write_points(root, {"motion_compensated": "true"}, **columns, time_offset_ns=offsets)
    np.testing.assert_allclose(drive_of(root).points(FRAMES[step]).xyz_ego_m, stored, atol=1e-4)


def test_pictures_by_path(root: Path) -> None:
    (root / "pictures").mkdir()
    for frame in FRAMES:
        (root / f"pictures/{frame}.PNG").write_bytes(open_door.png())
    paths = [f"pictures/{frame}.PNG" for frame in FRAMES]
    write_table(root / f"images/{SEGMENT}.parquet", open_door.image_columns(data=None, path=paths))
    drive = drive_of(root)
    assert drive.image(FRAMES[0], "front") is not None
    assert {path.name for path in drive.files} >= {f"{frame}.PNG" for frame in FRAMES}


def test_missing_pictures_are_counted(root: Path) -> None:
    some = {name: values[:2] for name, values in open_door.image_columns().items()}
    write_table(root / f"images/{SEGMENT}.parquet", some)
    drive = drive_of(root)
    assert drive.image(FRAMES[3], "front") is None
    assert drive.skipped == {"no front picture": 2}
    write_table(root / f"images/{SEGMENT}.parquet", open_door.image_columns(camera=["rear"] * 4))
    drive = drive_of(root)
    assert drive.cameras == () and drive.skipped == {"rear picture without calibration": 4}


@pytest.mark.parametrize(("model", "count"), [("none", 0), ("none", 3), ("brown", 5), ("fisheye", 4)])
def test_lenses(model: str, count: int, root: Path) -> None:
    given = [0.01] * count
    columns = open_door.camera_columns(distortion_model=[model], distortion=[given or None])
    write_table(root / f"cameras/{SEGMENT}.parquet", columns)
    (camera,) = drive_of(root).cameras
    assert camera.distortion_model == ("fisheye" if model == "fisheye" else "brown")
    assert camera.distortion.tolist() == (given if model != "none" else [0] * 5)


def nested(values: list[Any], kind: pa.DataType) -> pa.Array:
    return pa.array(values, pa.list_(kind))


FAR = [np.full(1280, 2e4)] * 4
WRONG_POINTS = [
    ("a column is missing", {"z_m": None}, "lacks the column z_m"),
    ("times are text", {"time_ns": ["noon"] * 4}, "time_ns is of type string"),
    ("frames are fractions", {"frame": [1.0, 2.0, 3.0, 4.0]}, "frame is of type double"),
    ("a time is empty", {"time_ns": pa.array([1, 2, None, 4], pa.int64())}, "1 empty cells"),
    ("frames go back", {"frame": [3, 4, 2, 7]}, "frame 2 comes after frame 4"),
    (
        "times go back",
        {"time_ns": [10**12, 10**12 + 10**8, 10**12, 10**12 + 10**9]},
        "not later than frame 4",
    ),
    ("times are microseconds", {"time_ns": [0, 100_000, 200_000, 300_000]}, "only 100000 ns later"),
    (
        "some poses are empty",
        {"world_from_ego": nested([np.eye(4).ravel(), None] * 2, pa.float64())},
        "all rows or none",
    ),
    (
        "a pose has 12 numbers",
        {"world_from_ego": nested([[1.0] * 12] * 4, pa.float64())},
        "has 12 numbers, expected 16",
    ),
    (
        "a pose is no rotation",
        {"world_from_ego": nested([[2.0] * 16] * 4, pa.float64())},
        "is not a rotation",
    ),
    ("a list is shorter", {"y_m": [[1.0]] * 4}, "lists of different lengths"),
    ("places are text", {"x_m": [["a"]] * 4}, "expected a list of numbers"),
    ("a sweep is empty", {"x_m": nested([None] * 4, pa.float32())}, "lists of different lengths"),
    ("a sweep has nulls inside", {"x_m": nested([[None] * 1280] * 4, pa.float32())}, "numbers are null"),
    ("places are kilometres off", {"x_m": FAR, "y_m": FAR, "z_m": FAR}, "check the unit"),
    ("intensities are bytes", {"intensity": [np.full(1280, 255.0)] * 4}, "expected 0 to 1; divide"),
    ("a sensor number is large", {"sensor": nested([[300] * 1280] * 4, pa.int64())}, "column sensor"),
    (
        "offsets are of another unit",
        {"time_offset_ns": nested([[10**12] * 1280] * 4, pa.int64())},
        "nanoseconds within",
    ),
]


@pytest.mark.parametrize(
    ("changes", "message"), [case[1:] for case in WRONG_POINTS], ids=[case[0] for case in WRONG_POINTS]
)
def test_wrong_points_are_one_clear_line(changes: dict[str, Any], message: str, root: Path) -> None:
    write_points(root, **changes)
    with pytest.raises(BadInput) as failure:
        drive_of(root).points(FRAMES[0])
    assert message in str(failure.value)
    assert f"points/{SEGMENT}.parquet" in str(failure.value)
    assert_one_line(failure.value)


WRONG_CAMERAS = [
    ("a name twice", {"camera": ["front"] * 2}, None),
    ("no focal length", {"fx_px": [0.0]}, "focal length"),
    ("a focal length that is no number", {"fy_px": [np.nan]}, "focal length"),
    ("no size", {"width_px": [0]}, "no size of a picture"),
    ("another size than the picture", {"width_px": [99]}, "but its calibration says 99 x 60"),
    ("an unknown lens", {"distortion_model": ["ftheta"]}, "'ftheta', expected one of none, brown, fisheye"),
    (
        "too few coefficients",
        {"distortion_model": ["brown"], "distortion": [[0.1]]},
        "has 1 numbers, expected 5",
    ),
    (
        "coefficients that are no numbers",
        {"distortion_model": ["brown"], "distortion": [[np.nan] * 5]},
        "finite",
    ),
    (
        "a mount that is a mirror",
        {"ego_from_camera": [np.diag([1.0, 1, -1, 1]).ravel()]},
        "is not a rotation",
    ),
    ("a mount far away", {"ego_from_camera": [(np.eye(4) + np.eye(4, k=3) * 500).ravel()]}, "moves by 500 m"),
]


@pytest.mark.parametrize(
    ("changes", "message"), [case[1:] for case in WRONG_CAMERAS], ids=[case[0] for case in WRONG_CAMERAS]
)
def test_wrong_cameras_are_one_clear_line(changes: dict[str, Any], message: str | None, root: Path) -> None:
    columns = open_door.camera_columns(**changes)
    if message is None:
        columns = {
            name: pa.concat_arrays([pa.array(values), pa.array(values)])
            for name, values in open_door.camera_columns().items()
        }
        message = "two rows of one camera"
    write_table(root / f"cameras/{SEGMENT}.parquet", columns)
    with pytest.raises(BadInput) as failure:
        drive_of(root)
    assert message in str(failure.value)
    assert_one_line(failure.value)


@pytest.mark.parametrize(
    "path", ["../secret.png", "/etc/passwd", "a/../../secret.png", "link.png", "", "a\0b", "..\\secret.png"]
)
def test_no_picture_outside_the_folder_is_opened(path: str, root: Path) -> None:
    (root.parent / "secret.png").write_bytes(open_door.png())
    (root / "link.png").symlink_to(root.parent / "secret.png")
    write_table(root / f"images/{SEGMENT}.parquet", open_door.image_columns(data=None, path=[path] * 4))
    with pytest.raises(BadInput, match="expected the relative path of a file below"):
        drive_of(root)


def test_a_damaged_picture_is_one_clear_line(root: Path) -> None:
    data = [b"no picture", open_door.png()[:50], None, b""]
    write_table(
        root / f"images/{SEGMENT}.parquet",
        open_door.image_columns(frame=FRAMES[::-1], data=pa.array(data, pa.binary())),
    )
    with pytest.raises(BadInput, match="row 0 cannot be read"):
        drive_of(root)
    data[0] = open_door.png()
    write_table(root / f"images/{SEGMENT}.parquet", open_door.image_columns(data=pa.array(data, pa.binary())))
    drive = drive_of(root)
    for frame, message in zip(
        FRAMES[1:], ("not a whole", "neither path nor data", "neither path nor data"), strict=True
    ):
        with pytest.raises(BadInput, match=message):
            drive.image(frame, "front")


def test_a_folder_without_drives_says_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "000001.pcd").touch()
    with pytest.raises(
        BadInput, match=r"expected points/<segment>\.parquet in it, found 1 file like 000001\.pcd"
    ):
        ParquetDrives(tmp_path)


def test_a_name_that_is_no_name(tmp_path: Path) -> None:
    write_table(tmp_path / "points/a drive.parquet", open_door.point_columns())
    with pytest.raises(BadInput, match="rename it"):
        ParquetDrives(tmp_path)


def test_poses_of_large_coordinates_keep_their_digits(root: Path) -> None:
    drive = drive_of(root)
    assert drive.world_from_ego is not None
    place = apply(drive.world_from_ego[1], np.zeros((1, 3)))[0]
    assert place[1] == 5.6e6
