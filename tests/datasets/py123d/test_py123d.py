"""Logs of py123d, written by the library itself: axes, units, times, poses, lenses, and what is refused."""

from __future__ import annotations

import io
import math
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("py123d", reason="needs the extra py123d")

from py123d.api.scene.arrow.arrow_log_writer import SyncConfig
from py123d.datatypes import (
    Camera,
    CameraID,
    EgoStateSE3,
    EgoStateSE3Metadata,
    FisheyeMEICameraMetadata,
    FisheyeMEIDistortion,
    FisheyeMEIProjection,
    FThetaCameraMetadata,
    FThetaIntrinsics,
    PinholeCameraMetadata,
    PinholeDistortion,
    PinholeIntrinsics,
    Timestamp,
)
from py123d.geometry import PoseSE3

from datasets.contract import assert_one_line, check_dataset
from datasets.py123d import py123d_log as tiny
from datasets.py123d.py123d_log import COUNT, FRONT_MOUNT, LOG, SPLIT, START_US, STEP_US, write_log
from upvl_cli.datasets.py123d.dataset import Py123dLogs
from upvl_cli.datasets.py123d.drive import Py123dDrive
from upvl_cli.datasets.registry import dataset_family
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project


def drive_of(root: Path) -> Py123dDrive:
    return Py123dLogs(root).open(LOG)


def drive_with(root: Path, *modalities: Any, **options: Any) -> Py123dDrive:
    """A log of two iterations: each modality is given by a function of its step, or left out where it is None."""
    steps = [[found for make in modalities if (found := make(step)) is not None] for step in range(2)]
    return drive_of(write_log(root, steps, **options))


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


def test_a_camera_looks_where_it_is_mounted(tmp_path: Path) -> None:
    (camera,) = drive_of(write_log(tmp_path)).cameras
    ahead = np.array([[11.0, -1.0, 1.5], [11.0, 0.0, 0.5], [-5, 0, 0]])
    uv_px, depth_m, inside = project(camera, ahead)
    np.testing.assert_allclose(depth_m[:2], 10)
    np.testing.assert_allclose(uv_px[:2], [[59.5 + 6, 29.5], [59.5, 29.5 + 6]], atol=1e-3)  # 6 (1 + 1e-4)
    assert inside.tolist() == [True, True, False]


def pinhole(distortion: tuple[float, ...] | None, **options: Any) -> PinholeCameraMetadata:
    return PinholeCameraMetadata(
        "any",
        CameraID.PCAM_L0,
        PinholeIntrinsics(70, 72, 60, 30),
        None if distortion is None else PinholeDistortion(*distortion),
        120,
        60,
        FRONT_MOUNT,
        **options,
    )


def ftheta(
    polynomial: tuple[float, ...] = (0, 60, 0.5, -2.0, 0.3, 0), cx: float = 59.5
) -> FThetaCameraMetadata:
    lens = FThetaIntrinsics(cx, 29.5, np.array(polynomial, dtype=float), np.zeros(6))
    return FThetaCameraMetadata("any", CameraID.FTCAM_F0, lens, 120, 60, FRONT_MOUNT)


def mei(mirror: float | None = 2.2) -> FisheyeMEICameraMetadata:
    """A lens like that of KITTI-360, in a smaller picture."""
    return FisheyeMEICameraMetadata(
        "any",
        CameraID.FMCAM_L,
        mirror,
        FisheyeMEIDistortion(0.017, 1.65, 0.0, 0.0),
        FisheyeMEIProjection(133.6, 133.5, 71.7, 69.8),
        140,
        140,
        FRONT_MOUNT,
    )


LENSES = [
    ("pinhole without distortion", pinhole(None), 1e-6),
    ("pinhole with distortion", pinhole((-0.1, 0.02, 0.003, -0.002, 0.001)), 1e-6),
    ("pinhole, rectified", pinhole((-0.1, 0.02, 0, 0, 0), is_undistorted=True), 1e-6),
    ("f-theta", ftheta(), 0.1),
    ("mirror", mei(), 0.1),
]


@pytest.mark.parametrize(("lens", "off_px"), [case[1:] for case in LENSES], ids=[case[0] for case in LENSES])
def test_a_lens_shows_what_the_library_shows(lens: Any, off_px: float, tmp_path: Path) -> None:
    content = tiny.picture((lens.width, lens.height))
    drive = drive_with(tmp_path, tiny.sweep, lambda step: tiny.photo(step, lens, content))
    (camera,) = drive.cameras
    assert drive.image(0, camera.name) is not None
    rng = np.random.default_rng(1)
    places = np.column_stack([rng.uniform(2, 20, 400), rng.uniform(-20, 20, 400), rng.uniform(-9, 12, 400)])
    in_camera = (places - FRONT_MOUNT.array[:3]) @ FRONT_MOUNT.rotation_matrix
    expected, seen, _ = lens.project_to_image(in_camera)
    seen &= (expected > 1).all(axis=1) & (expected < (lens.width - 2, lens.height - 2)).all(axis=1)
    assert seen.sum() > 20
    uv_px, _, inside = project(camera, places)
    assert inside[seen].all()
    assert np.abs(uv_px - expected)[seen].max() < off_px


USELESS = [
    ("no intrinsics", PinholeCameraMetadata("any", CameraID.PCAM_L0, None, None, 120, 60, FRONT_MOUNT)),
    ("no mirror parameter", mei(None)),
    ("a lens that turns back", ftheta((0, 60, 0, -60, 0, 0))),
    ("a lens unlike any other", ftheta((30, 5, 0, 0, 0, 4))),
]


@pytest.mark.parametrize("lens", [case[1] for case in USELESS], ids=[case[0] for case in USELESS])
def test_a_camera_without_a_useful_lens_is_left_out_and_counted(lens: Any, tmp_path: Path) -> None:
    drive = drive_with(tmp_path, tiny.sweep, lambda step: tiny.photo(step, lens))
    assert drive.cameras == ()
    assert drive.skipped == {f"{lens.modality_key} without a calibration that can be used": 1}


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


def test_a_camera_without_pictures_of_sweeps_is_left_out(tmp_path: Path) -> None:
    steps = [[tiny.sweep(0)], [tiny.photo(1)]]
    assert drive_of(write_log(tmp_path, steps)).cameras == ()


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


@pytest.mark.parametrize("pictures", ["png_binary", "mp4"])
def test_pictures_however_they_are_stored(pictures: str, tmp_path: Path) -> None:
    drive = drive_with(tmp_path, tiny.sweep, tiny.photo, pictures=pictures)
    check_dataset(Py123dLogs(tmp_path))
    image = drive.image(1, "pcam_f0")
    assert image is not None
    assert np.abs(image.rgb.reshape(-1, 3).mean(axis=0) - tiny.RED).max() < 6
    assert (tmp_path / tiny.LOG_FOLDER / "camera.pcam_f0.mp4" in drive.files) == (pictures == "mp4")


def test_a_video_is_read_from_two_threads(tmp_path: Path) -> None:
    count = 20
    colors = [(12 * step, 12 * step, 12 * step) for step in range(count)]
    steps = [
        [tiny.sweep(step), tiny.photo(step, content=tiny.picture(color=colors[step]))]
        for step in range(count)
    ]
    drive = drive_of(write_log(tmp_path, steps, pictures="mp4"))

    def grey(frame: int) -> float:
        image = drive.image(frame, "pcam_f0")
        assert image is not None
        return float(image.rgb.mean())

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(grey, [*range(count), *range(count)[::-1]]))
    np.testing.assert_allclose(found[:count], [color[0] for color in colors], atol=4)
    assert found[:count] == found[count:][::-1]


def test_a_picture_of_a_file_that_is_not_there_is_one_line(tmp_path: Path, monkeypatch: Any) -> None:
    def photo(step: int) -> Any:
        found = tiny.photo(step)
        found._dataset_root, found._relative_path, found._byte_string = tmp_path, f"cam/{step}.jpg", None
        return found

    drive = drive_with(tmp_path, tiny.sweep, photo, pictures="path")
    with pytest.raises(BadInput, match=r"cannot be read by py123d .*root of the source data set") as failure:
        drive.image(0, "pcam_f0")
    assert_one_line(failure.value)
    import py123d.common.runtime.dataset_paths as paths

    monkeypatch.setattr(paths.DatasetPaths, "get_sensor_root", lambda self, dataset: tmp_path)
    with pytest.raises(BadInput, match="Camera file not found"):
        drive.image(0, "pcam_f0")
    (tmp_path / "cam").mkdir()
    (tmp_path / "cam/0.jpg").write_bytes(tiny.picture())
    (tmp_path / "cam/1.jpg").write_bytes(tiny.picture((40, 30)))
    image = drive.image(0, "pcam_f0")
    assert image is not None and image.rgb.shape == (60, 120, 3)
    with pytest.raises(BadInput, match=r"picture of shape \(30, 40, 3\), but its calibration says 120 x 60"):
        drive.image(1, "pcam_f0")


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
    (
        "no focal length",
        (tiny.sweep, lambda step: tiny.photo(step, flat())),
        "expected a focal length of 1 to",
    ),
    (
        "a lens that is no number",
        (tiny.sweep, lambda step: tiny.photo(step, ftheta(cx=np.nan))),
        "not finite",
    ),
]


def flat() -> PinholeCameraMetadata:
    return PinholeCameraMetadata(
        "flat", CameraID.PCAM_F0, PinholeIntrinsics(0, 9, 9, 9), None, 120, 60, FRONT_MOUNT
    )


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


def test_opening_a_drive_looks_at_the_size_of_a_picture(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is 60 x 60 pixels"):
        drive_with(tmp_path, tiny.sweep, lambda step: tiny.photo(step, content=tiny.picture((60, 60))))


def test_nothing_is_written_on_stderr_about_a_damaged_picture(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """OpenCV would, and not by Python."""
    noise = np.random.default_rng(0).integers(0, 255, (60, 120, 3), dtype=np.uint8)
    content = io.BytesIO()
    Image.fromarray(noise).save(content, "JPEG")
    half = content.getvalue()[: len(content.getvalue()) // 2] + b"\xff\xd9"
    drive = drive_with(tmp_path, tiny.sweep, lambda step: tiny.photo(step, content=half))
    assert drive.image(0, "pcam_f0") is not None  # what is missing is grey
    assert capfd.readouterr().err == ""


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
