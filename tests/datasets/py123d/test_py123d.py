"""Logs of py123d, written by the library itself: axes, units, times, poses, lenses, and what is refused."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("py123d.api", reason="needs the extra py123d")

from py123d.api.scene.arrow.arrow_log_writer import SyncConfig
from py123d.datatypes import (
    Camera,
    CameraID,
    EgoStateSE3,
    EgoStateSE3Metadata,
    PinholeCameraMetadata,
    PinholeIntrinsics,
    Timestamp,
)
from py123d.geometry import PoseSE3

from datasets.contract import assert_one_line, check_dataset
from datasets.py123d import py123d_log as tiny
from datasets.py123d.py123d_log import (
    COUNT,
    LOG,
    SPLIT,
    START_US,
    STEP_US,
    drive_of,
    drive_with,
    write_log,
)
from upvl_cli.datasets.py123d.dataset import Py123dLogs
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.errors import BadInput


@pytest.mark.parametrize("codec", ["ipc", "ipc_zstd", "ipc_lz4", "laz", "draco"])
def test_the_contract_of_datasets(codec: str, tmp_path: Path) -> None:
    write_log(tmp_path, codec=codec)
    check_dataset(dataset_family("py123d").open(tmp_path, None))


@pytest.mark.parametrize("absent", ["ego_state", "photo", "boxes"])
def test_a_log_without(absent: str, tmp_path: Path) -> None:
    makers = {"ego_state": tiny.ego_state, "photo": tiny.photo, "boxes": tiny.boxes, "sweep": tiny.sweep}
    del makers[absent]
    drive = drive_with(tmp_path, *makers.values())
    check_dataset(Py123dLogs(tmp_path))
    assert (drive.world_from_ego is None) == (absent == "ego_state")
    assert (drive.cameras == ()) == (absent == "photo")


def test_what_a_drive_holds(tmp_path: Path) -> None:
    drive = drive_of(write_log(tmp_path))
    assert [frame.index for frame in drive.frames] == list(range(COUNT))
    assert [frame.time_ns for frame in drive.frames] == [
        1000 * (START_US + STEP_US * step) for step in range(COUNT)
    ]
    assert drive.world_from_ego is not None
    expected = np.eye(4)
    c, s = math.cos(0.04), math.sin(0.04)
    expected[:2, :2] = [[c, -s], [s, c]]
    expected[:3, 3] = (400_001, 5.6e6, 30)
    np.testing.assert_allclose(drive.world_from_ego[2], expected, rtol=0, atol=1e-9)
    points = drive.points(1)
    np.testing.assert_array_equal(points.xyz_ego_m, tiny.ego_points())
    assert set(points.intensity.tolist()) == {np.float32(51 / 255)}
    assert set(points.sensor.tolist()) == {2, 7}
    assert (points.time_offset_ns[0], points.time_offset_ns[-1]) == (0, 90_000_000)
    assert abs(drive.ground_z_m - tiny.GROUND_Z_M) < 0.02
    image = drive.image(1, "pcam_f0")
    assert image is not None and image.time_ns == 1000 * (START_US + STEP_US + 20_000)
    assert np.abs(image.rgb.reshape(-1, 3).mean(axis=0) - tiny.RED).max() < 3
    assert {path.name for path in drive.files} == {
        "sync.arrow",
        "ego_state_se3.arrow",
        "lidar.lidar_merged.arrow",
        "camera.pcam_f0.arrow",
    }


def test_missing_pictures_and_sweeps_are_counted(tmp_path: Path) -> None:
    steps = [
        [tiny.ego_state(0), tiny.sweep(0), tiny.photo(0)],
        [tiny.ego_state(1)],
        [tiny.ego_state(2), tiny.sweep(2)],
        [tiny.sweep(3), tiny.photo(3)],  # its pose lies behind the last state
        [tiny.sweep(30)],
    ]
    root = write_log(tmp_path, steps, times_us=[tiny.time_us(step) for step in (0, 1, 2, 3, 30)])
    drive = drive_of(root)
    check_dataset(Py123dLogs(root))
    assert [frame.index for frame in drive.frames] == [0, 2, 3]
    assert drive.skipped == {
        "iteration without a sweep": 1,
        "sweep without an ego state": 1,
        "no pcam_f0 picture": 1,
    }
    assert drive.image(2, "pcam_f0") is None


def test_time_and_pose_between_states(tmp_path: Path) -> None:
    """States at another rate than sweeps: a sweep that starts at 0.13 s has the pose of that time."""
    times = [0, 1, 2]
    states = [tiny.ego_state(step) for step in times]
    lidar = tiny.sweep(0)
    lidar._timestamp = Timestamp.from_us(START_US + 130_000)
    lidar._timestamp_end = Timestamp.from_us(START_US + 190_000)
    sync = SyncConfig("ego_state_se3.timestamp_us", "forward")
    drive = drive_of(write_log(tmp_path, [[state] for state in states[:2]] + [[lidar, states[2]]], sync=sync))
    (frame,) = drive.frames
    assert frame.index == 1 and frame.time_ns == 1000 * (START_US + 130_000)
    assert drive.world_from_ego is not None
    expected = tiny.pose(1.3).transformation_matrix
    np.testing.assert_allclose(drive.world_from_ego[0], expected, rtol=0, atol=2e-4)


def test_a_sweep_that_lasts_across_its_iteration_has_the_time_of_the_iteration(tmp_path: Path) -> None:
    """As KITTI-360 is written: the sweep starts 50 ms before the pose."""
    times_us = [tiny.time_us(step) + 50_000 for step in range(2)]
    drive = drive_with(tmp_path, tiny.sweep, times_us=times_us)
    assert [frame.time_ns for frame in drive.frames] == [1000 * time for time in times_us]
    assert drive.points(0).time_offset_ns[0] == -50_000_000


def test_a_sweep_that_two_iterations_name_is_one_frame(tmp_path: Path) -> None:
    drive = drive_with(tmp_path, lambda step: tiny.sweep(0), times_us=[START_US, START_US + 10_000])
    assert [frame.index for frame in drive.frames] == [0]
    assert drive.skipped == {"iteration with the sweep of the one before": 1}


def test_several_lidars_are_one_sweep(tmp_path: Path) -> None:
    """Also where one is missing now and then."""
    top = np.full((5, 3), 4.0, np.float32)
    drive = drive_with(
        tmp_path,
        lambda step: tiny.sweep(step, tiny.TOP, top, ids=None),
        lambda step: tiny.sweep(step, tiny.DOWN, top + 1, ids=None, intensity=None) if step else None,
    )
    check_dataset(Py123dLogs(tmp_path))
    assert drive.lidars == ("lidar.lidar_down", "lidar.lidar_top")
    assert [frame.index for frame in drive.frames] == [1]
    points = drive.points(1)
    assert points.sensor.tolist() == [7] * 5 + [2] * 5
    assert points.intensity.tolist() == [0] * 5 + [np.float32(51 / 255)] * 5


def test_a_merged_lidar_decides_on_frames_and_single_ones_add_to_it(tmp_path: Path) -> None:
    """As TruckDrive is written."""
    near = np.full((5, 3), 4.0, np.float32)
    drive = drive_with(
        tmp_path,
        lambda step: tiny.sweep(step, tiny.DOWN, near, ids=None) if step == 0 else None,
        tiny.sweep,
    )
    assert drive.lidars == ("lidar.lidar_merged", "lidar.lidar_down")
    count = len(tiny.ego_points())
    assert [len(drive.points(frame.index)) for frame in drive.frames] == [count + 5, count]


def test_points_on_the_car_and_without_a_place_are_dropped(tmp_path: Path) -> None:
    x_m, half_m = tiny.CENTER_X_M, tiny.OUTLINE_LWH_M[0] / 2
    places = np.array(
        [
            [x_m + half_m - 0.1, 0.9, 0.5],
            [x_m + half_m + 0.1, 0.9, 0.5],
            [np.nan, 1, 1],
            [9, np.inf, 1],
            [x_m, 0, 1.2],
        ],
        np.float32,
    )
    for_all = {"ids": None, "intensity": None, "timestamps": None}
    drive = drive_with(tmp_path, tiny.ego_state, lambda step: tiny.sweep(step, tiny.TOP, places, **for_all))
    np.testing.assert_array_equal(drive.points(0).xyz_ego_m, places[[1, 4]])
    other = drive_with(tmp_path / "no car", lambda step: tiny.sweep(step, tiny.TOP, places, **for_all))
    np.testing.assert_array_equal(other.points(0).xyz_ego_m, places[[0, 1, 4]])


def test_times_of_another_origin_are_no_times(tmp_path: Path) -> None:
    drive = drive_with(
        tmp_path, lambda step: tiny.sweep(step, timestamps=np.arange(len(tiny.ego_points()), dtype=np.int64))
    )
    assert not drive.points(0).time_offset_ns.any()


def test_names_of_logs(tmp_path: Path) -> None:
    steps = [[tiny.sweep(0)]]
    for split, log in (("a_val", "one"), ("b_train", "one"), ("b_train", "part/two"), ("odd-split", "three")):
        write_log(tmp_path, steps, split=split, log=log)
    dataset = Py123dLogs(tmp_path)
    assert dataset.segments == ("a_val.one", "b_train.one", "three", "two")
    check_dataset(dataset)


def test_a_name_that_is_no_name(tmp_path: Path) -> None:
    write_log(tmp_path, [[tiny.sweep(0)]], log="a log")
    with pytest.raises(BadInput, match="rename it"):
        Py123dLogs(tmp_path)


def test_a_folder_without_logs_says_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    with pytest.raises(
        BadInput, match=r"expected logs/<split>/<log>/sync\.arrow in it, found 1 file like maps"
    ):
        Py123dLogs(tmp_path)


def nowhere(step: int) -> EgoStateSE3:
    pose = PoseSE3(np.nan, 0, 0, 1, 0, 0, 0)
    return EgoStateSE3.from_imu(pose, tiny.EGO, Timestamp.from_us(tiny.time_us(step)))


def mirrored(step: int) -> Camera:
    mount = PoseSE3(0, 0, 0, 2, 0, 0, 0)
    lens = PinholeCameraMetadata("m", CameraID.PCAM_F0, PinholeIntrinsics(9, 9, 9, 9), None, 120, 60, mount)
    return tiny.photo(step, lens)


def cloud(values: Any) -> Any:
    return lambda step: tiny.sweep(
        step, tiny.TOP, np.asarray(values), ids=None, intensity=None, timestamps=None
    )


WRONG = [
    ("a pose is no number", (tiny.sweep, nowhere), "imu_se3 moves by nan m"),
    ("a mount has another length", (tiny.sweep, mirrored), "camera_to_imu_se3 is a quaternion of length 2"),
    ("no LiDAR", (tiny.ego_state,), "has no LiDAR; expected lidar.lidar_merged.arrow"),
    ("places are kilometres off", (cloud(np.full((4, 3), 2e4)),), "a point 2e+04 m away, expected metres"),
    (
        "a picture has another size",
        (tiny.sweep, lambda step: tiny.photo(step, content=tiny.picture((60, 60)))),
        "is 60 x 60 pixels, but its calibration says 120 x 60",
    ),
    (
        "half a picture",
        (tiny.sweep, lambda step: tiny.photo(step, content=tiny.picture((120, 60))[:200] + b"\xff\xd9")),
        "not a whole JPEG or PNG",
    ),
]


@pytest.mark.parametrize(
    ("modalities", "message"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG]
)
def test_wrong_logs_are_one_clear_line(modalities: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as failure:
        drive = drive_with(tmp_path, *modalities)
        drive.points(0)
        drive.image(0, "pcam_f0")
    assert message in str(failure.value)
    assert f"logs/{SPLIT}/{LOG}" in str(failure.value)
    assert_one_line(failure.value)


def test_a_car_of_no_size_has_no_outline(tmp_path: Path) -> None:
    huge = EgoStateSE3Metadata("huge", 1e9, 1e9, 1e9, 3, PoseSE3.identity(), PoseSE3.identity())
    drive = drive_with(
        tmp_path,
        tiny.sweep,
        lambda step: EgoStateSE3.from_imu(tiny.pose(step), huge, Timestamp.from_us(tiny.time_us(step))),
    )
    assert drive.outline is None and len(drive.points(0)) == len(tiny.ego_points())


def test_a_file_that_the_library_would_skip_is_an_error(tmp_path: Path) -> None:
    root = write_log(tmp_path)
    shutil.copy(root / tiny.LOG_FOLDER / "sync.arrow", root / tiny.LOG_FOLDER / "camera.pcam_x9.arrow")
    with pytest.raises(BadInput, match=r"pcam_x9\.arrow has no description that py123d can read"):
        drive_of(root)


def test_a_damaged_file_is_named_even_if_it_is_not_used(tmp_path: Path) -> None:
    root = write_log(tmp_path)
    (root / tiny.LOG_FOLDER / "radar.merged.arrow").write_bytes(b"ARROW1\0\0 no more")
    with pytest.raises(BadInput, match=r"radar\.merged\.arrow cannot be read by py123d"):
        drive_of(root)
