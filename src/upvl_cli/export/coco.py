"""COCO: `annotations/<drive>.json`, the rectangle of each box in each picture that shows it, `images/<drive>/...`.

`bbox` is left, top, width, height in pixels from the corner of the picture (cocodataset.org, data format); upvl counts
from the centre of the first pixel, half a pixel on. Rectangles are those of the time of the sweep; a box that another
one hides has its rectangle too. `track_id`, `score`, `visible_share` and `box3d` are further keys.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.format import ExportFormat, ExportOptions
from upvl_cli.export.json_value import JsonValue
from upvl_cli.export.sweeps import write_picture
from upvl_cli.export.tool_files import frame_name, numbers_beside, write_json
from upvl_cli.geometry.box_projection import projected_boxes
from upvl_cli.geometry.boxes import corners
from upvl_cli.types import Array, ParallelArrays, array

_HALF_PX = 0.5


def write(drives: Iterable[ExportDrive], folder: Path, options: ExportOptions, losses: Losses) -> None:
    """Write one file of annotations a drive; pictures where they are wanted."""
    (folder / "annotations").mkdir()
    categories: dict[str, int] = {}
    for drive in drives:
        for name in np.unique(drive.boxes.class_name):
            categories.setdefault(str(name), len(categories) + 1)
        content, shown = _content(drive, categories)
        path = folder / "annotations" / f"{drive.name}.json"
        write_json(path, content | {"categories": [_category(*item) for item in categories.items()]})
        losses["boxes that no camera sees: they are in no picture"] += int((~shown).sum())
        losses["drives without a camera: they have no picture"] += not drive.cameras
        for frame in drive.frames if options.with_data else ():
            for camera in drive.cameras:
                name = _file_name(drive.name, camera.name, frame.index)
                write_picture(drive, frame.index, camera, folder / "images" / name)


def _file_name(drive: str, camera: str, frame: int) -> str:
    return f"{drive}/{camera}/{frame_name(frame)}.png"


def _category(name: str, number: int) -> dict[str, Any]:
    return {"id": number, "name": name, "supercategory": ""}


def _content(drive: ExportDrive, categories: Mapping[str, int]) -> tuple[dict[str, Any], Array]:
    """Return pictures and annotations of a drive, and (n,) which boxes are in any."""
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    shown = np.zeros(len(drive.boxes), dtype=np.bool_)
    for frame in drive.frames:
        own = np.flatnonzero(drive.boxes.frame == frame.index)
        boxes = drive.boxes[own]
        box_corners = corners(boxes)
        for camera in drive.cameras:
            images.append(
                {
                    "id": len(images) + 1,
                    "width": camera.width_px,
                    "height": camera.height_px,
                    "file_name": _file_name(drive.name, camera.name, frame.index),
                    "drive": drive.name,
                    "camera": camera.name,
                    "frame": frame.index,
                    "time_ns": frame.time_ns,
                }
            )
            edges_px, share = projected_boxes(camera, box_corners)
            for i in np.flatnonzero(share > 0):
                shown[own[i]] = True
                extras = {"image_id": len(images), "visible_share": float(share[i])}
                number = categories[str(boxes.class_name[i])]
                annotation = _annotation(boxes, int(i), edges_px[i]) | extras | {"category_id": number}
                annotations.append({"id": len(annotations) + 1} | annotation)
    info = {"description": f"boxes of {drive.name} in its pictures", "version": "1.0"}
    return {"info": info, "images": images, "annotations": annotations}, shown


def _annotation(boxes: ExportBoxes, i: int, edges_px: Array) -> dict[str, Any]:
    left, top, right, bottom = (float(value) for value in edges_px)
    place = zip(("x_m", "y_m", "z_m"), boxes.center_m[i], strict=True)
    size = zip(("length_m", "width_m", "height_m"), boxes.size_lwh_m[i], strict=True)
    box = {name: float(value) for name, value in (*place, *size)}
    numbers = numbers_beside(boxes, i)
    return {
        "bbox": [left + _HALF_PX, top + _HALF_PX, right - left, bottom - top],
        "area": (right - left) * (bottom - top),
        "iscrowd": 0,
        "segmentation": [],
        "track_id": int(boxes.track_id[i]),
        "score": numbers.pop("score", 1.0),
        "box3d": box | {"heading_rad": float(boxes.heading_rad[i])} | numbers,
    }


@dataclass(frozen=True)
class PictureBoxes(ParallelArrays):
    """Rectangles of a drive: frame and camera of the picture, edges as in `types.Boxes2d`, track, class and score."""

    frame: Array = array("int64")
    camera: Array = array("str")
    xyxy_px: Array = array("float64", 4)
    track_id: Array = array("int64")
    class_name: Array = array("str")
    score: Array = array("float64")


def read_rectangles(path: Path) -> PictureBoxes:
    """Return the rectangles of a file; raises `BadInput` where it is none of this format."""
    content = JsonValue.of_file(path)
    names = {
        entry.member("id").integer(): entry.member("name").text()
        for entry in content.member("categories").elements()
    }
    images = {entry.member("id").integer(): entry for entry in content.member("images").elements()}
    found: list[tuple[int, str, list[float], int, str, float]] = []
    for entry in content.member("annotations").elements():
        image, name = images[entry.member("image_id").integer()], names[entry.member("category_id").integer()]
        left, top, width, height = entry.member("bbox").list_of_numbers((4,))
        edges = [left - _HALF_PX, top - _HALF_PX, left + width - _HALF_PX, top + height - _HALF_PX]
        track, score = entry.member("track_id").integer(), entry.member("score").number()
        found.append(
            (image.member("frame").integer(), image.member("camera").text(), edges, track, name, score)
        )
    columns = zip(*found, strict=True) if found else [[]] * 6
    return PictureBoxes(*(np.array(list(column)) for column in columns))


FORMAT = ExportFormat("coco", write, None)
