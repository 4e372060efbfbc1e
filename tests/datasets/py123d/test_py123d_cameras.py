"""Cameras of py123d logs: lenses, mounts, and pictures however they are stored."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("py123d.api", reason="needs the extra py123d")

from py123d.datatypes import (
    CameraID,
    FisheyeMEICameraMetadata,
    FisheyeMEIDistortion,
    FisheyeMEIProjection,
    FThetaCameraMetadata,
    FThetaIntrinsics,
    PinholeCameraMetadata,
    PinholeDistortion,
    PinholeIntrinsics,
)

from datasets.contract import assert_one_line, check_dataset
from datasets.py123d import py123d_log as tiny
from datasets.py123d.py123d_log import FRONT_MOUNT, drive_of, drive_with, write_log
from upvl_cli.datasets.py123d.dataset import Py123dLogs
from upvl_cli.errors import BadInput
from upvl_cli.geometry.camera import project


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


def test_a_camera_without_pictures_of_sweeps_is_left_out(tmp_path: Path) -> None:
    steps = [[tiny.sweep(0)], [tiny.photo(1)]]
    assert drive_of(write_log(tmp_path, steps)).cameras == ()


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


FLAT = PinholeCameraMetadata(
    "flat", CameraID.PCAM_F0, PinholeIntrinsics(0, 9, 9, 9), None, 120, 60, FRONT_MOUNT
)


@pytest.mark.parametrize(
    ("lens", "message"),
    [(FLAT, "expected a focal length of 1 to"), (ftheta(cx=np.nan), "a calibration that is not finite")],
)
def test_an_impossible_lens_is_one_clear_line(lens: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=message) as failure:
        drive_with(tmp_path, tiny.sweep, lambda step: tiny.photo(step, lens))
    assert lens.modality_key in str(failure.value)
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
