"""SUSTechPOINTS: one car by hand, its scene folders, and what it gives back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import PointDrive, drive_of_one_car, read, write
from upvl_cli.datasets.recordings.scan_folder import ScanOptions
from upvl_cli.datasets.recordings.sustech import is_sustech, open_sustech
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportDrive

LABEL = Path("one/label/0000000007.json")


def test_a_car_ahead_that_heads_to_the_left(tmp_path: Path) -> None:
    write(drive_of_one_car(), "sustechpoints", tmp_path)
    assert json.loads((tmp_path / LABEL).read_text()) == [
        {
            "obj_id": "12",
            "obj_type": "Car",
            "psr": {
                "position": {"x": 10.0, "y": 2.0, "z": 0.5},
                "scale": {"x": 4.0, "y": 2.0, "z": 1.5},
                "rotation": {"x": 0.0, "y": 0.0, "z": np.pi / 2},
            },
        }
    ]
    assert read("sustechpoints", tmp_path, drive_of_one_car()).class_name.tolist() == ["car"]


def test_the_scene_is_one_that_upvl_reads_as_a_recording(tmp_path: Path) -> None:
    drive = drive_of_one_car()
    drive = ExportDrive(
        drive.name, drive.frames, drive.world_from_ego, drive.cameras, drive.boxes, PointDrive()
    )
    write(drive, "sustechpoints", tmp_path, with_data=True)
    assert is_sustech(tmp_path / "one")
    recording = open_sustech(tmp_path / "one", ScanOptions(rate_hz=10))
    (camera,) = recording.cameras
    np.testing.assert_allclose(camera.ego_from_camera, drive.cameras[0].ego_from_camera, atol=1e-12)
    np.testing.assert_allclose(camera.intrinsic, drive.cameras[0].intrinsic)


def test_what_the_tool_saves_is_read(tmp_path: Path) -> None:
    """Boxes that it turned about all axes, without an id, with attributes; newer servers wrap the list."""
    write(labelled_drive(), "sustechpoints", tmp_path)
    place, scale = {"x": 1, "y": 2, "z": 3}, {"x": 4, "y": 2, "z": 1.5}
    psr = {"position": place, "scale": scale, "rotation": {"x": -0.05, "y": 0.003, "z": 4.6}}
    boxes = [
        {"psr": psr, "obj_type": "Bus", "obj_id": "", "obj_attr": "door open", "annotator": "somebody"},
        {"psr": psr | {"rotation": {"x": 0, "y": 0, "z": 1.0}}, "obj_type": "Car", "obj_id": 7},
        {"psr": psr, "obj_type": "Crane", "obj_id": "new"},
    ]
    path = tmp_path / "bend-1" / "label" / "0000000003.json"
    path.write_text(json.dumps({"frame": "3", "objs": boxes}))
    found = read("sustechpoints", tmp_path, labelled_drive())
    found = found[found.frame == 3]
    assert found.class_name.tolist() == ["bus", "vehicle", "Crane"]
    assert found.track_id[1] == 7 and len(set(found.track_id.tolist())) == 3
    # A tilt of 3 degrees leaves the heading where it was but for a thousandth.
    np.testing.assert_allclose(found.heading_rad, [4.6 - 2 * np.pi, 1.0, 4.6 - 2 * np.pi], atol=2e-3)


def test_a_tilted_box_keeps_the_heading_of_its_nose(tmp_path: Path) -> None:
    """By three.js's order XYZ: after a quarter turn about x, a turn about z lifts the nose instead."""
    write(drive_of_one_car(), "sustechpoints", tmp_path)
    content = json.loads((tmp_path / LABEL).read_text())
    content[0]["psr"]["rotation"] = {"x": np.pi / 2, "y": 0.0, "z": 0.4}
    (tmp_path / LABEL).write_text(json.dumps(content))
    heading = read("sustechpoints", tmp_path, drive_of_one_car()).heading_rad
    np.testing.assert_allclose(heading, [0.0], atol=1e-12)


def test_a_file_of_another_name_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "sustechpoints", tmp_path)
    (tmp_path / LABEL).rename((tmp_path / LABEL).with_name("frame_7.json"))
    with pytest.raises(BadInput, match="'frame_7' is no frame; expected its number, as in 0000000007"):
        read("sustechpoints", tmp_path, drive_of_one_car())
