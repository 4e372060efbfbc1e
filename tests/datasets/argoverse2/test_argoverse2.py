"""Logs of Argoverse 2: axes, units, times, poses, pictures, ground heights and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets.argoverse2 import av2_log
from datasets.argoverse2.av2_log import (
    ATTITUDE,
    AXLE_M,
    FIRST_NS,
    LOG,
    PERIOD_NS,
    Log,
    write_feather,
    write_log,
)
from datasets.contract import check_dataset, check_labels
from upvl_cli.datasets.argoverse2.dataset import Argoverse2
from upvl_cli.datasets.argoverse2.labels import ArgoverseLabels
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project
from upvl_cli.perception.ground.source import GroundSource

# Over the ground, along the axes of the car: it rides 2 m/s faster than the car, which leans.
CYCLIST_MPS = ATTITUDE.inv().apply([0, av2_log.SPEED_MPS, 0]) + [2, 0, 0]


@pytest.fixture
def log(tmp_path: Path) -> Log:
    return write_log(tmp_path)


def opened(log: Log):  # noqa: ANN201
    return Argoverse2(log.root).open(LOG)


def test_the_contract_of_datasets(log: Log) -> None:
    check_dataset(Argoverse2(log.root))
    check_labels(ArgoverseLabels(Argoverse2(log.root)), opened(log))


def test_the_folder_of_splits_of_one_split_or_of_one_log_will_do(log: Log) -> None:
    for root in (log.root, log.folder.parent, log.folder):
        assert Argoverse2(root).segments == (LOG,)
    with pytest.raises(BadInput, match=r"has no log of Argoverse 2; expected <root>/<split>/<log>/sensors"):
        Argoverse2(log.folder / "map")
    shutil.copytree(log.folder, log.root / "train" / LOG)
    with pytest.raises(BadInput, match="have one name"):
        Argoverse2(log.root)


def test_points_are_those_of_the_file_with_both_lidars_told_apart(log: Log) -> None:
    points = opened(log).points(1)
    np.testing.assert_allclose(points.xyz_ego_m[[0, -1]], [[2, 3, 1.5], [2, 10, 1.5]])
    np.testing.assert_allclose(points.intensity[[0, -1]], [215 / 255, 254 / 255], rtol=1e-6)
    np.testing.assert_array_equal(points.sensor, np.repeat([0, 1], 20))
    np.testing.assert_array_equal(points.time_offset_ns, np.arange(40) * 2_500_000)


@pytest.mark.parametrize("compression", ["lz4", "zstd", "uncompressed"])
def test_tables_of_any_compression_and_precision(log: Log, compression: str) -> None:
    columns = av2_log.sweep_columns(0)
    for name in "xyz":
        columns[name] = columns[name].astype(np.float32)
    write_feather(log.folder / f"sensors/lidar/{FIRST_NS}.feather", columns, compression)
    np.testing.assert_allclose(opened(log).points(0).xyz_ego_m[0], [2, 3, 0.5])


def test_poses_are_those_of_the_sweeps_also_between_given_ones(log: Log) -> None:
    drive = opened(log)
    assert [frame.time_ns for frame in drive.frames] == av2_log.sweep_times(3).tolist()
    pose = drive.world_from_ego
    assert pose is not None
    np.testing.assert_allclose(pose[:, :3, 3], av2_log.position_city_m(av2_log.sweep_times(3)), atol=1e-6)
    np.testing.assert_allclose(pose[:, :3, :3], np.tile(ATTITUDE.as_matrix(), (3, 1, 1)), atol=1e-9)


def test_a_sweep_before_the_first_pose_or_after_the_last_is_left_out(log: Log) -> None:
    for time_ns in (FIRST_NS - PERIOD_NS, FIRST_NS + 3 * PERIOD_NS):
        write_feather(log.folder / f"sensors/lidar/{time_ns}.feather", av2_log.sweep_columns(9))
    drive = opened(log)
    assert [frame.index for frame in drive.frames] == [1, 2, 3]
    assert drive.skipped == {"sweep without pose": 2}


def test_a_log_without_poses_leaves_them_to_odometry(log: Log) -> None:
    (log.folder / "city_SE3_egovehicle.feather").unlink()
    drive = opened(log)
    assert drive.world_from_ego is None and len(drive.frames) == 3
    assert np.isnan(ArgoverseLabels(Argoverse2(log.root)).labels(LOG).velocity_mps).all()


def test_between_poses_the_car_turns_evenly() -> None:
    from scipy.spatial.transform import Rotation

    from upvl_cli.datasets.argoverse2.poses import CityTrajectory, poses_at

    ends = np.tile(np.eye(4), (2, 1, 1))
    ends[1, :3, :3] = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    ends[1, :3, 3] = [4, 0, 0]
    pose, known = poses_at(CityTrajectory(np.array([0, 400_000_000]), ends), np.array([100_000_000, -1]))
    assert known.tolist() == [True, False]
    np.testing.assert_allclose(
        Rotation.from_matrix(pose[0, :3, :3]).as_euler("zyx", degrees=True), [10, 0, 0]
    )
    np.testing.assert_allclose(pose[0, :3, 3], [1, 0, 0])
    _, known = poses_at(CityTrajectory(np.array([0, 600_000_000]), ends), np.array([100_000_000]))
    assert not known[0], "across a long gap nobody knows"


def test_a_place_is_seen_where_the_picture_has_it(log: Log) -> None:
    drive = opened(log)
    camera = drive.cameras[0]
    assert [known.name for known in drive.cameras] == ["ring_side_left", "stereo_front_left"]
    # 10 m to the left of the camera, 1 m ahead of it and 0.5 m above: 10 px to the right of the middle, 5 px up.
    place = av2_log.MOUNT_M + [1.0, 10.0, 0.5]
    pixel, _, is_seen = project(camera, place[None])
    assert is_seen.all()
    np.testing.assert_allclose(pixel[0], [av2_log.CX + 10, av2_log.CY - 5], atol=1e-9)
    assert not camera.distortion.any(), "the pictures are published without distortion"


def test_each_picture_is_the_nearest_with_its_own_time(log: Log) -> None:
    drive = opened(log)
    for frame in drive.frames:
        image = drive.image(frame.index, "ring_side_left")
        assert image is not None and image.time_ns == frame.time_ns + 12_000_000
        assert abs(int(image.rgb[0, 0, 0]) - 40 * frame.index) <= 2
    pictures = sorted((log.folder / "sensors/cameras/ring_side_left").iterdir())
    pictures[2].unlink()
    image = opened(log).image(1, "ring_side_left")
    assert image is not None and image.time_ns == FIRST_NS + 62_000_000, (
        "38 ms before the sweep, not 62 after it"
    )
    for path in pictures[3:]:
        path.unlink()
    drive = opened(log)
    assert drive.image(1, "ring_side_left") is not None, "38 ms before the sweep"
    assert drive.image(2, "ring_side_left") is None, "138 ms before the sweep"
    assert drive.skipped == {"no ring_side_left picture": 1}


def test_pictures_without_calibration_are_counted(log: Log) -> None:
    (log.folder / "sensors/cameras/stereo_front_left").rename(log.folder / "sensors/cameras/ring_new")
    drive = opened(log)
    assert [camera.name for camera in drive.cameras] == ["ring_side_left"]
    assert drive.skipped == {"ring_new picture without calibration": 6}


def test_a_picture_of_another_size_is_refused(log: Log) -> None:
    path = min((log.folder / "sensors/cameras/ring_side_left").iterdir())
    Image.new("RGB", (48, 64)).save(path)
    with pytest.raises(BadInput, match=r"is 48 x 64 pixels, but its calibration says 64 x 48"):
        opened(log)


def test_the_ground_of_the_map_below_places(log: Log) -> None:
    drive = opened(log)
    assert isinstance(drive, GroundSource)
    # Truth: the height along the z axis of the ego at which a place meets the ground, 20 m in the city.
    xyz = np.array(
        [[5.0, 3.0, 0.0], [5.0, 3.0, 2.0], [-4.0, -2.0, 0.0], [0.0, 15.0, 0.0], [0.0, -400.0, 0.0]]
    )
    z = drive.ground_z(2, xyz)
    position = av2_log.position_city_m(drive.frames[2].time_ns)[0]
    on_ground = xyz[:3].copy()
    on_ground[:, 2] = z[:3]
    np.testing.assert_allclose((ATTITUDE.apply(on_ground) + position)[:, 2], 20.0, atol=1e-6)
    assert abs(z[0] - (-AXLE_M + 5 * np.tan(np.radians(1)))) < 1e-3
    assert np.isnan(z[3:]).all(), "beyond 8 m to the left, and outside of the map"
    assert drive.ground_z(0, np.zeros((0, 3))).shape == (0,)


def test_without_a_map_there_is_no_ground_height(log: Log) -> None:
    shutil.rmtree(log.folder / "map")
    with pytest.raises(BadInput, match=r'has no ground heights .* set method = "estimate" in ground.toml'):
        opened(log).ground_z(0, np.zeros((1, 3)))


def test_labels(log: Log) -> None:
    source = ArgoverseLabels(Argoverse2(log.root))
    labels = source.labels(LOG)
    assert labels.frame.tolist() == [0, 0, 1, 1, 2]
    cyclist, parked = labels[labels.object_id == "cyclist"], labels[labels.object_id == "parked"]
    assert cyclist.type.tolist() == [4, 4] and parked.type.tolist() == [1, 1, 1]
    np.testing.assert_allclose(parked.velocity_mps, 0, atol=1e-6)
    np.testing.assert_allclose(cyclist.velocity_mps, [CYCLIST_MPS] * 2, atol=1e-6)
    np.testing.assert_allclose(np.abs(parked.heading_rad), np.pi)
    np.testing.assert_allclose(parked.size_lwh_m[0], [5, 2, 3])
    np.testing.assert_allclose(parked.center_m[0], ATTITUDE.inv().apply([3, 20, 0]))
    assert parked.num_points.tolist() == [0, 1, 2]


def test_labels_of_times_without_a_sweep_give_velocities_only(log: Log) -> None:
    (log.folder / f"sensors/lidar/{FIRST_NS + PERIOD_NS}.feather").unlink()
    source = ArgoverseLabels(Argoverse2(log.root))
    labels = source.labels(LOG)
    assert source.frames(LOG).tolist() == [0, 1]
    assert labels.frame.tolist() == [0, 0, 1]
    cyclist = labels[labels.object_id == "cyclist"]
    np.testing.assert_allclose(cyclist.velocity_mps, [CYCLIST_MPS], atol=1e-6)


def test_a_log_of_the_test_split_has_no_labels(log: Log) -> None:
    (log.folder / "annotations.feather").unlink()
    source = ArgoverseLabels(Argoverse2(log.root))
    for read in (source.labels, source.frames):
        with pytest.raises(BadInput, match="has no labels; expected annotations.feather"):
            read(LOG)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("laser_number", np.full(40, 64, np.uint8), "laser_number of row 0 is 64, expected 0 to 63"),
        ("intensity", np.full(40, 300, np.int32), "intensity of row 0 is 300, expected 0 to 255"),
        ("offset_ns", np.full(40, 2**40, np.int64), "offset_ns of row 0"),
        ("x", np.full(40, 2e4, np.float32), "40 of 40 points are more than 10 km away"),
        ("y", ["a"] * 40, "the column y is of type string, expected float64"),
    ],
)
def test_what_no_sweep_holds_is_refused(log: Log, name: str, value: object, message: str) -> None:
    path = log.folder / f"sensors/lidar/{FIRST_NS}.feather"
    write_feather(path, {**av2_log.sweep_columns(0), name: value})
    with pytest.raises(BadInput, match=message):
        opened(log).points(0)


def test_points_that_are_no_number_are_left_out_and_counted(log: Log) -> None:
    columns = av2_log.sweep_columns(0)
    columns["z"][3:5] = np.nan
    write_feather(log.folder / f"sensors/lidar/{FIRST_NS}.feather", columns)
    drive = opened(log)
    assert len(drive.points(0)) == len(drive.points(0)) == 38
    assert drive.skipped_points == {0: {"points without a return (not a number)": 2}}


def test_a_column_that_is_missing_is_named(log: Log) -> None:
    columns = av2_log.sweep_columns(0)
    del columns["offset_ns"], columns["laser_number"]
    write_feather(log.folder / f"sensors/lidar/{FIRST_NS}.feather", columns)
    with pytest.raises(BadInput, match="lacks the columns laser_number, offset_ns"):
        opened(log).points(0)


# ---- the real log


@pytest.mark.real
def test_the_real_log(shared: Path) -> None:
    dataset = Argoverse2(shared / "data/av2_real")
    check_dataset(dataset)
    drive = dataset.open(dataset.segments[0])
    check_labels(ArgoverseLabels(dataset), drive)
    points = drive.points(0)
    assert np.bincount(points.sensor).tolist() == [51890, 48770]
    # A laser of up_lidar has one elevation as seen from where that is mounted: lasers are told apart rightly.
    away = points.xyz_ego_m - np.array([1.35018, 0.0, 1.64042], np.float32)
    elevation = np.degrees(np.arctan2(away[:, 2], np.hypot(away[:, 0], away[:, 1])))
    near = np.linalg.norm(away, axis=1) < 25
    first = near & (points.sensor == 0)
    assert np.percentile(elevation[first], 1) < -24.9 and np.percentile(elevation[first], 99) < 15.1
    labels = ArgoverseLabels(dataset).labels(drive.name)
    assert len(labels) == 47 and np.isfinite(labels.velocity_mps).all()
    # The data set's own count of points inside its boxes.
    from upvl_cli.datasets.shared.tracks import count_points

    np.testing.assert_array_equal(count_points(labels, drive).num_points, labels.num_points)


@pytest.mark.real
def test_the_map_of_the_real_log_agrees_with_its_ground_points(shared: Path) -> None:
    dataset = Argoverse2(shared / "data/av2_real")
    drive = dataset.open(dataset.segments[0])
    xyz = drive.points(0).xyz_ego_m
    height_m = xyz[:, 2] - drive.ground_z(0, xyz)
    assert np.isfinite(height_m).mean() > 0.9
    near = np.hypot(xyz[:, 0], xyz[:, 1]) < 20
    on_ground = near & (np.abs(height_m) < 0.3)
    assert on_ground.sum() > 10_000 and abs(np.median(height_m[on_ground])) < 0.02
    below = drive.ground_z(0, np.zeros((1, 3)))
    assert abs(below[0] - drive.ground_z_m) < 0.01
