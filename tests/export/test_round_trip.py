"""What every format gives back, and what it says it cannot."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.export.format import POINTS, SCORE, TRACK, VELOCITY, ExportOptions
from upvl_cli.export.formats import FORMATS, export_format
from upvl_cli.export.manifest import MANIFEST
from upvl_cli.export.run import export, read_back
from upvl_cli.geometry.se3 import apply, rotate, wrap_angle
from upvl_cli.types import concat

WITH_BOXES = [name for name in FORMATS if export_format(name).read is not None]


def round_trip(name: str, drives: list[ExportDrive], folder: Path) -> dict[str, ExportBoxes]:
    fmt = export_format(name)
    export(drives, fmt, folder, ExportOptions(), Counter())
    return read_back(fmt, folder, {drive.name: drive for drive in drives})


def in_order(boxes: ExportBoxes) -> ExportBoxes:
    return boxes[np.lexsort([boxes.track_id, boxes.frame])]


@pytest.mark.parametrize("name", WITH_BOXES)
def test_boxes_come_back_equal(name: str, tmp_path: Path) -> None:
    drives = [labelled_drive("bend-1"), labelled_drive("bend-2", frames=3, first_index=0)]
    found = round_trip(name, drives, tmp_path / "out")
    carries = export_format(name).carries
    assert list(found) == ["bend-1", "bend-2"]
    for drive in drives:
        before, after = in_order(drive.boxes), in_order(found[drive.name])
        assert after.frame.tolist() == before.frame.tolist()
        np.testing.assert_allclose(after.center_m, before.center_m, atol=1e-3)
        np.testing.assert_allclose(after.size_lwh_m, before.size_lwh_m, atol=1e-3)
        turn = wrap_angle(after.heading_rad - before.heading_rad)
        np.testing.assert_allclose(np.rad2deg(turn), 0.0, atol=0.01)
        assert after.class_name.tolist() == before.class_name.tolist()
        if TRACK in carries:
            assert after.track_id.tolist() == before.track_id.tolist()
        if SCORE in carries:
            np.testing.assert_allclose(after.score, before.score, atol=1e-6)
        if VELOCITY in carries:
            np.testing.assert_allclose(after.velocity_mps[:, :2], before.velocity_mps[:, :2], atol=1e-3)
        if POINTS in carries:
            assert after.num_points.tolist() == before.num_points.tolist()


@pytest.mark.parametrize("name", WITH_BOXES)
def test_a_car_that_drives_forward_still_does(name: str, tmp_path: Path) -> None:
    drive = labelled_drive()
    (boxes,) = round_trip(name, [drive], tmp_path / "out").values()
    drive = drive.with_boxes(boxes)
    poses = drive.world_from_ego[drive.places]
    place_world = np.array(
        [apply(pose, center[None])[0] for pose, center in zip(poses, boxes.center_m, strict=True)]
    )
    nose = np.column_stack([np.cos(boxes.heading_rad), np.sin(boxes.heading_rad), np.zeros(len(boxes))])
    nose_world = rotate(poses, nose[:, None])[:, 0]
    for track in np.unique(boxes.track_id):
        own = np.flatnonzero(boxes.track_id == track)
        way = place_world[own[-1]] - place_world[own[0]]
        assert (nose_world[own] @ way > 0.99 * np.linalg.norm(way)).all()


@pytest.mark.parametrize("name", list(FORMATS))
def test_a_drive_without_boxes_is_an_export(name: str, tmp_path: Path) -> None:
    drive = labelled_drive().with_boxes(concat([], ExportBoxes))
    export([drive], export_format(name), tmp_path / "out", ExportOptions(), Counter())
    assert (tmp_path / "out" / MANIFEST).is_file()


@pytest.mark.parametrize("name", list(FORMATS))
def test_what_is_lost_is_told(name: str, tmp_path: Path) -> None:
    fmt, drive = export_format(name), labelled_drive()
    told = export([drive], fmt, tmp_path / "out", ExportOptions(), Counter())
    for reason in {SCORE, VELOCITY, TRACK, POINTS} - fmt.carries:
        assert told[f"{reason}, for which the format has no place"] == len(drive.boxes)
    assert json.loads((tmp_path / "out" / MANIFEST).read_text())["not_carried"] == told


@pytest.mark.parametrize("name", list(FORMATS))
def test_the_same_labels_give_the_same_bytes(name: str, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        export([labelled_drive()], export_format(name), tmp_path / folder, ExportOptions(), Counter())
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert files
    for path in files:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes(), path


def test_a_folder_of_other_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(BadSetting, match="holds files that no export made"):
        export([labelled_drive()], export_format("csv"), tmp_path, ExportOptions(), Counter())
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_an_export_that_fails_leaves_the_one_before(tmp_path: Path) -> None:
    export([labelled_drive()], export_format("csv"), tmp_path / "out", ExportOptions(), Counter())
    before = (tmp_path / "out" / "bend-1.csv").read_bytes()

    def broken() -> object:
        yield labelled_drive(frames=1)
        raise BadInput("a drive is damaged")

    with pytest.raises(BadInput):
        export(broken(), export_format("csv"), tmp_path / "out", ExportOptions(), Counter())
    assert (tmp_path / "out" / "bend-1.csv").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_classes_never_share_a_name(tmp_path: Path) -> None:
    drive = labelled_drive()
    names = np.array(["vehicle", "car", "Car", "van", "person"] * 6)
    boxes = ExportBoxes(
        **{n: getattr(drive.boxes, n) for n in drive.boxes.__dataclass_fields__} | {"class_name": names}
    )
    (back,) = round_trip("kitti", [drive.with_boxes(boxes)], tmp_path / "out").values()
    assert sorted(set(back.class_name)) == sorted(set(names))


def test_a_format_that_nobody_knows_is_refused() -> None:
    with pytest.raises(BadSetting, match="did you mean 'kitti'"):
        export_format("kiti")
