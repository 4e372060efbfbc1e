"""COCO: one rectangle by hand, the library of COCO, and objects that no camera sees."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from export.labelled_drives import labelled_drive
from export.one_car import PointDrive, drive_of_one_car, write
from upvl_cli.errors import BadSetting
from upvl_cli.export.coco import read_rectangles
from upvl_cli.export.drive import ExportDrive
from upvl_cli.export.formats import export_format
from upvl_cli.export.run import read_back
from upvl_cli.geometry.box_projection import projected_boxes
from upvl_cli.geometry.boxes import corners


def content_of(folder: Path, name: str = "one") -> dict[str, Any]:
    return json.loads((folder / "annotations" / f"{name}.json").read_text())


def test_the_rectangle_of_a_car_ahead(tmp_path: Path) -> None:
    """The camera stands at (1.5, 0.2, 1.6) and looks forward; f 500, centre (320, 240).

    The car fills x 9 to 11, y 0 to 4, z -0.25 to 1.25. Its near side is 7.5 m before the camera, its far one 9.5 m.
    """
    write(drive_of_one_car(), "coco", tmp_path)
    content = content_of(tmp_path)
    (image,), (annotation,) = content["images"], content["annotations"]
    left, right = 320 - 500 * 3.8 / 7.5, 320 + 500 * 0.2 / 7.5
    top, bottom = 240 + 500 * 0.35 / 9.5, 240 + 500 * 1.85 / 7.5
    # Half a pixel on: COCO counts from the corner of the picture, upvl from the centre of the first pixel.
    expected = [left + 0.5, top + 0.5, right - left, bottom - top]
    np.testing.assert_allclose(annotation["bbox"], expected)
    assert annotation["area"] == pytest.approx((right - left) * (bottom - top))
    assert (annotation["track_id"], annotation["score"], annotation["visible_share"]) == (12, 0.75, 1.0)
    assert annotation["box3d"]["heading_rad"] == np.pi / 2
    assert content["categories"] == [{"id": annotation["category_id"], "name": "car", "supercategory": ""}]
    assert (image["width"], image["height"]) == (640, 480)
    assert image["file_name"] == "one/front/0000000007.png"


def test_rectangles_and_ids_come_back(tmp_path: Path) -> None:
    drive = labelled_drive()
    write(drive, "coco", tmp_path)
    found = read_rectangles(tmp_path / "annotations" / "bend-1.json")
    count = 0
    for camera in drive.cameras:
        edges_px, share = projected_boxes(camera, corners(drive.boxes))
        for i in np.flatnonzero(share > 0):
            own = found[(found.frame == drive.boxes.frame[i]) & (found.camera == camera.name)]
            own = own[own.track_id == drive.boxes.track_id[i]]
            np.testing.assert_allclose(own.xyxy_px, edges_px[i : i + 1], atol=1e-9)
            assert own.score.tolist() == [drive.boxes.score[i]]
            count += 1
    assert len(found) == count > 6


def test_objects_that_no_camera_sees_are_told(tmp_path: Path) -> None:
    told = write(drive_of_one_car(center_m=[[-10.0, 0, 0.5]]), "coco", tmp_path / "behind")
    assert told == {"boxes that no camera sees: they are in no picture": 1}
    drive = drive_of_one_car()
    blind = ExportDrive(drive.name, drive.frames, drive.world_from_ego, (), drive.boxes)
    told = write(blind, "coco", tmp_path / "blind")
    assert told["drives without a camera: they have no picture"] == 1
    assert len(read_rectangles(tmp_path / "blind" / "annotations" / "one.json")) == 0


def test_the_library_of_coco_reads_it(tmp_path: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pip install 'upvl[coco]'")
    write(labelled_drive(), "coco", tmp_path)
    loaded = coco.COCO(str(tmp_path / "annotations" / "bend-1.json"))
    (category,) = loaded.getCatIds(catNms=["pedestrian"])
    annotations = loaded.loadAnns(loaded.getAnnIds(catIds=[category]))
    assert {entry["track_id"] for entry in annotations} == {17}


def test_pictures_lie_where_their_names_say(tmp_path: Path) -> None:
    drive = drive_of_one_car()
    drive = ExportDrive(
        drive.name, drive.frames, drive.world_from_ego, drive.cameras, drive.boxes, PointDrive()
    )
    write(drive, "coco", tmp_path, with_data=True)
    (image,) = content_of(tmp_path)["images"]
    with Image.open(tmp_path / "images" / image["file_name"]) as picture:
        assert picture.size == (640, 480)


def test_boxes_in_three_dimensions_do_not_come_back(tmp_path: Path) -> None:
    drive = drive_of_one_car()
    write(drive, "coco", tmp_path)
    with pytest.raises(BadSetting, match="do not come back from the format coco"):
        read_back(export_format("coco"), tmp_path, {"one": drive})
