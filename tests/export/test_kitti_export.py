"""KITTI's conventions by numbers that a person can check: one car ahead of a camera at the ego origin."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.export.drive import ExportDrive, boxes_of_rows
from upvl_cli.export.format import ExportOptions
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import export, read_back
from upvl_cli.types import Camera, Frame

LOOKS_FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
FRONT = Camera(
    "front", 1000, 400, np.array([[500.0, 0, 500], [0, 500, 200], [0, 0, 1]]), np.zeros(5), LOOKS_FORWARD
)


def drive_of(heading_rad: float, x_m: float = 10.0, cameras: tuple[Camera, ...] = (FRONT,)) -> ExportDrive:
    """A car of 4 x 2 x 1.5 m whose centre is `x_m` ahead, 2 m to the left and 0.5 m up."""
    boxes = boxes_of_rows(
        [np.array([x_m, 2.0, 0.5, 4.0, 2.0, 1.5, heading_rad])],
        frame=[4],
        track_id=[17],
        class_name=np.array(["vehicle"]),
        score=[0.75],
        velocity_mps=np.zeros((1, 3)),
    )
    frames = (Frame(2, 100), Frame(4, 200))
    return ExportDrive("a", frames, np.tile(np.eye(4), (2, 1, 1)), cameras, boxes)


def columns(folder: Path, drive: ExportDrive, name: str = "kitti", camera: str = "") -> list[str]:
    export([drive], export_format(name), folder, ExportOptions(camera), Counter())
    path = "label_2/000001.txt" if name == "kitti" else "label_02/0000.txt"
    return (folder / "training" / path).read_text().split()


@pytest.mark.parametrize(
    ("heading_deg", "rotation_y"),
    [(0, -np.pi / 2), (90, np.pi), (180, np.pi / 2), (-90, 0.0)],
    ids=["drives away", "to the left", "comes nearer", "to the right"],
)
def test_rotation_y(heading_deg: float, rotation_y: float, tmp_path: Path) -> None:
    found = columns(tmp_path / "to", drive_of(np.deg2rad(heading_deg)))
    turn = (float(found[14]) - rotation_y + np.pi) % (2 * np.pi) - np.pi
    assert turn == pytest.approx(0.0, abs=1e-5)
    # The camera sees the car 2 m to the left at 10 m: alpha is rotation_y less the direction to it.
    alpha = (float(found[3]) - rotation_y - np.arctan2(2, 10) + np.pi) % (2 * np.pi) - np.pi
    assert alpha == pytest.approx(0.0, abs=1e-5)


def test_size_bottom_score_and_class(tmp_path: Path) -> None:
    found = columns(tmp_path / "to", drive_of(0.0))
    assert found[0] == "Car"
    assert [float(value) for value in found[8:14]] == [1.5, 2.0, 4.0, -2.0, 0.25, 10.0]
    assert float(found[15]) == 0.75


def test_the_rectangle_is_that_of_the_picture(tmp_path: Path) -> None:
    found = columns(tmp_path / "to", drive_of(0.0))
    # Its near end is 8 m away: from 1 to 3 m to the left, from 1.25 m above the camera to 0.25 m below.
    left, top, right, bottom = (
        500 - 500 * 3 / 8,
        200 - 500 * 1.25 / 8,
        500 - 500 * 1 / 12,
        200 + 500 * 0.25 / 8,
    )
    np.testing.assert_allclose([float(value) for value in found[4:8]], [left, top, right, bottom], atol=1e-4)
    assert float(found[1]) == 0.0


def test_a_box_behind_the_camera_has_no_rectangle(tmp_path: Path) -> None:
    drive = drive_of(0.0, x_m=-10.0)
    told = export([drive], export_format("kitti"), tmp_path / "to", ExportOptions(), Counter())
    found = (tmp_path / "to" / "training" / "label_2" / "000001.txt").read_text().split()
    assert found[4:8] == ["-1.000000"] * 4
    assert told["boxes that the picture does not show: written without a rectangle"] == 1


def test_tracking_counts_frames_from_0(tmp_path: Path) -> None:
    assert columns(tmp_path / "to", drive_of(0.0), "kitti-tracking")[:3] == ["1", "17", "Car"]


def test_the_camera_can_be_chosen(tmp_path: Path) -> None:
    turned = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # looks to the left
    left = Camera("left", 1000, 400, FRONT.intrinsic, np.zeros(5), turned)
    drive = drive_of(0.0, cameras=(left, FRONT))
    assert columns(tmp_path / "a", drive)[13] == "10.000000"
    assert columns(tmp_path / "b", drive, camera="left")[13] == "2.000000"
    with pytest.raises(BadSetting, match="no camera 'rear'"):
        columns(tmp_path / "c", drive, camera="rear")


def test_a_changed_number_of_lines_gets_tracks_of_its_own(tmp_path: Path) -> None:
    columns(tmp_path / "to", drive_of(0.0))
    path = tmp_path / "to" / "training" / "label_2" / "000001.txt"
    path.write_text(path.read_text() * 2 + "DontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n")
    (boxes,) = read_back(export_format("kitti"), tmp_path / "to", {"a": drive_of(0.0)}).values()
    assert boxes.track_id.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Car 0 0 0 0 0 0 0 1.5 2", "has 10 columns; expected 15"),
        ("Car 0 0 0 0 0 0 0 1.5 x 4 0 0 10 0", "holds no numbers only"),
        ("Car 0 0 0 0 0 0 0 nan 2 4 0 0 10 0", "without a size or a place"),
    ],
    ids=["columns", "word", "nan"],
)
def test_a_line_that_is_no_label_is_named(line: str, message: str, tmp_path: Path) -> None:
    columns(tmp_path / "to", drive_of(0.0))
    (tmp_path / "to" / "training" / "label_2" / "000001.txt").write_text(line + "\n")
    with pytest.raises(BadInput, match=message):
        read_back(export_format("kitti"), tmp_path / "to", {"a": drive_of(0.0)})
