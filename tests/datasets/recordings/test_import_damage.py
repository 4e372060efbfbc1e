"""Whatever lies in a folder: an import works, or says in one line what is wrong and leaves no table."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.recordings.street import INTRINSIC, picture, times_ns, write_scans, write_tum
from upvl_cli.commands.import_drive import ImportRequest, ScanOptions, import_drive
from upvl_cli.datasets.parquet.dataset import ParquetDrives
from upvl_cli.errors import UpvlError

CAMERA = """[[cameras]]
name = "front"
pictures = "camera/front"
width_px = 64
height_px = 48
fx_px = 40.0
fy_px = 40.0
cx_px = 31.5
cy_px = 23.5
distortion_model = "brown"
distortion = [0.1, 0.0, 0.0, 0.0, 0.0]
lidar_from_camera = [0, 0, 1, 0.2, -1, 0, 0, 0, 0, -1, 0, -0.1, 0, 0, 0, 1]
"""
PIECES = [
    "",
    "\n",
    "\0",
    "é",
    "[",
    "]",
    '"',
    "=",
    "-",
    "1e999",
    "nan",
    "9" * 30,
    "null",
    "{",
    "../",
    "\ufeff",
    "0",
    "x",
]


def write_scene(folder: Path) -> None:
    """A scene of SUSTechPOINTS, with all that options can name beside it."""
    write_scans(folder / "lidar", frames=3)
    (folder / "camera/front").mkdir(parents=True)
    (folder / "calib/camera").mkdir(parents=True)
    for number in range(60, 63):
        (folder / "camera/front" / f"{number:06d}.png").write_bytes(picture(number))
    extrinsic = [-1.0, 0, 0, 0.2, 0, 0, -1, 0, 0, -1, 0, -0.1, 0, 0, 0, 1]
    calibration = {"extrinsic": extrinsic, "intrinsic": INTRINSIC.ravel().tolist()}
    (folder / "calib/camera/front.json").write_text(json.dumps(calibration))
    write_tum(folder / "poses.tum", [0, 1, 2])
    (folder / "times.txt").write_text("\n".join(f"{time_ns / 1e9:.6f}" for time_ns in times_ns(3)))
    (folder / "cameras.toml").write_text(CAMERA)
    (folder / "mount.txt").write_text(" ".join(map(str, np.eye(4).ravel().tolist())))


def damage(folder: Path, data: st.DataObject) -> None:
    """Change, empty, double, rename or remove one file."""
    path = data.draw(st.sampled_from(sorted(path for path in folder.rglob("*") if path.is_file())))
    content = path.read_bytes()
    place = data.draw(st.integers(0, len(content)))
    kinds = {
        "text": lambda: content[:place] + data.draw(st.sampled_from(PIECES)).encode() + content[place + 3 :],
        "bytes": lambda: content[:place] + data.draw(st.binary(max_size=4)) + content[place + 2 :],
        "empty": lambda: b"",
    }
    kind = data.draw(st.sampled_from([*kinds, "remove", "again", "folder", "rename"]))
    if kind in kinds:
        path.write_bytes(kinds[kind]())
    elif kind == "again":
        path.with_name("1" + path.name).write_bytes(content)
    elif kind == "rename":
        path.rename(path.with_name(data.draw(st.sampled_from(["a b.pcd", "7.PCD", "é.png", "0060.pcd"]))))
    else:
        path.unlink()
        if kind == "folder":
            path.mkdir()


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_damaged_folders_give_a_drive_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damaged") / "scene"
    write_scene(folder)
    for _ in range(data.draw(st.integers(1, 3))):
        damage(folder, data)
    scan = ScanOptions(
        poses=data.draw(st.sampled_from([None, folder / "poses.tum"])),
        times=data.draw(st.sampled_from([folder / "times.txt", None])),
        rate_hz=data.draw(st.sampled_from([None, 10.0])),
        mount=data.draw(st.sampled_from([None, folder / "mount.txt"])),
        cameras=data.draw(st.sampled_from([None, folder / "cameras.toml"])),
    )
    drives = folder.parent / "drives"
    source = data.draw(st.sampled_from([folder, folder / "lidar"]))
    with warnings.catch_warnings(action="error"):
        try:
            import_drive(ImportRequest(source, drives, "drive", scan), lambda *_: None)
        except UpvlError as error:
            assert len(str(error).splitlines()) == 1
            assert not (drives / "images" / "drive.parquet").exists()
            return
    drive = ParquetDrives(drives).open("drive")
    for frame in drive.frames:
        assert np.isfinite(drive.points(frame.index).xyz_ego_m).all()
        for camera in drive.cameras:
            drive.image(frame.index, camera.name)
