"""Tables of boxes: Parquet and JSON of COCO, by the drive's own names, and what damages do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from upvl_cli.boxes2d.base import CameraPicture
from upvl_cli.boxes2d.table import BoxTable2d, files, read_boxes
from upvl_cli.errors import BadInput
from upvl_cli.types import Camera, Frame

RGB = np.zeros((48, 64, 3), np.uint8)
COLUMNS: dict[str, list[Any]] = {
    "segment": ["drive", "drive", "drive", "other"],
    "frame": [3, 3, 4, 3],
    "camera": ["front", "left", "front", "front"],
    "x1": [10.0, 0, 1, 2],
    "y1": [20.0, 0, 1, 2],
    "x2": [30.0, 64, 3, 4],
    "y2": [40.0, 48, 3, 4],
    "score": [0.9, 0.5, 0.25, 1.0],
    "name": ["person", "car", "bus", "car"],
}
COCO: dict[str, list[dict[str, Any]]] = {
    "images": [
        {"id": 7, "file_name": "/somewhere/drive/front/0000000003.png"},
        {"id": 8, "segment": "drive", "frame": 3, "camera": "left"},
        {"id": 9, "file_name": "drive/front/4.jpg"},
        {"id": "a", "file_name": "other\\front\\3.jpg"},
    ],
    "annotations": [
        {"image_id": 7, "category_id": 1, "bbox": [10, 20, 20, 20], "score": 0.9},
        {"image_id": 8, "category_id": 3, "bbox": [0, 0, 64, 48], "score": 0.5},
        {"image_id": 9, "category_id": 6, "bbox": [1, 1, 2, 2], "score": 0.25},
        {"image_id": "a", "category_id": 3, "bbox": [2, 2, 2, 2]},
    ],
    "categories": [{"id": 1, "name": "person"}, {"id": 3, "name": "car"}, {"id": 6, "name": "bus"}],
}


def camera(name: str) -> Camera:
    return Camera(name, 64, 48, np.diag([50.0, 50, 1]), np.zeros(5), np.eye(4))


@dataclass(frozen=True)
class SmallDrive:
    """Two frames of two cameras."""

    name: str = "drive"
    frames: tuple[Frame, ...] = (Frame(3, 0), Frame(4, 1))
    cameras: tuple[Camera, ...] = (camera("front"), camera("left"))
    skipped = MappingProxyType({})


def parquet(folder: Path, **changes: list[Any]) -> Path:
    path = folder / "boxes.parquet"
    pq.write_table(pa.table({name: values for name, values in (COLUMNS | changes).items() if values}), path)
    return path


def coco(folder: Path, content: Any = COCO) -> Path:
    path = folder / "boxes.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize("write", [parquet, coco])
def test_each_picture_has_its_boxes_in_the_pixels_of_cameras(
    tmp_path: Path, write: Callable[[Path], Path]
) -> None:
    source = BoxTable2d(str(write(tmp_path)), SmallDrive())  # type: ignore[arg-type]
    found = source.boxes(CameraPicture(3, "front", RGB))
    assert found.xyxy_px.tolist() == [[9.5, 19.5, 29.5, 39.5]]  # from the centre of the first pixel
    assert (found.score.tolist(), found.name.tolist()) == ([0.9], ["person"])
    assert source.boxes(CameraPicture(3, "left", RGB)).name.tolist() == ["car"]
    assert source.boxes(CameraPicture(4, "front", RGB)).name.tolist() == ["bus"]
    assert len(source.boxes(CameraPicture(4, "left", RGB))) == 0
    assert source.dropped == {}


def test_scores_may_be_left_out(tmp_path: Path) -> None:
    assert read_boxes(parquet(tmp_path, score=[])).score.tolist() == [1, 1, 1, 1]
    assert read_boxes(coco(tmp_path)).score[-1] == 1


def test_what_the_drive_has_not_is_counted(tmp_path: Path) -> None:
    path = parquet(tmp_path, camera=["front", "rear", "front", "front"], frame=[3, 3, 99, 3])
    source = BoxTable2d(str(path), SmallDrive())  # type: ignore[arg-type]
    assert source.dropped == {
        "boxes of cameras that the drive has not": 1,
        "boxes of frames that the drive has not": 1,
    }


def changed(table: str, row: int, **values: Any) -> Callable[[Path], Path]:
    content = json.loads(json.dumps(COCO))
    content[table][row] |= values
    return lambda folder: coco(folder, content)


def without(table: str, row: int, key: str) -> Callable[[Path], Path]:
    content = json.loads(json.dumps(COCO))
    del content[table][row][key]
    return lambda folder: coco(folder, content)


BAD: list[tuple[Callable[[Path], Path], str]] = [
    (lambda folder: parquet(folder, name=[]), "lacks the column name"),
    (
        lambda folder: parquet(folder, frame=["3", "3", "4", "3"]),
        "column frame is of type string, expected whole",
    ),
    (lambda folder: parquet(folder, x1=[float("nan"), 0, 1, 2]), "box 0 has edges that are not finite"),
    (lambda folder: parquet(folder, x2=[30.0, -1, 3, 4]), "box 1 has a right or lower edge before the other"),
    (
        lambda folder: parquet(folder, score=[0.9, 0.5, 1.5, 1]),
        "box 2 has a score that is not between 0 and 1",
    ),
    (lambda folder: parquet(folder, name=["", "a", "b", "c"]), "box 0 has no name"),
    (lambda folder: parquet(folder, y1=[None, 0, 1, 2]), "column y1 has 1 empty cells"),
    (lambda folder: parquet(folder, x2=[130.0, 64, 3, 4]), "but its pictures have 64 x 48 px"),
    (
        lambda folder: parquet(folder, segment=["a", "b", "c", "d"]),
        "no box of the drive drive; it has a, b, c, d",
    ),
    (
        lambda folder: parquet(folder, camera=["c0", "c1", "c0", "c1"]),
        "in c0, c1; expected its cameras: front, left",
    ),
    (lambda folder: coco(folder, "{"), "cannot be read as JSON"),
    (lambda folder: coco(folder, "[" * 100_000), "cannot be read as JSON"),
    (lambda folder: coco(folder, COCO["annotations"]), "holds a list, expected an object with images"),
    (lambda folder: coco(folder, {"images": []}), "annotations is None, expected a list of objects"),
    (lambda folder: coco(folder, COCO | {"categories": [3]}), r"categories is \[3\], expected a list"),
    (
        changed("images", 0, file_name="front/3.png"),
        r"images\[0\]: file_name is 'front/3.png', expected SEGMENT/",
    ),
    (changed("images", 0, file_name="drive/front/a3.png"), "with the number of the frame"),
    (without("images", 0, "file_name"), r"images\[0\]: file_name is None"),
    (without("images", 1, "camera"), r"images\[1\]: has segment, frame alone"),
    (changed("images", 1, frame=3.5), "frame is 3.5, expected a whole number"),
    (changed("images", 1, frame=10**30), "expected a whole number"),
    (changed("annotations", 1, image_id=99), r"annotations\[1\]: image_id is 99, which none"),
    (changed("annotations", 1, category_id=[1]), r"category_id is \[1\], expected a number or a text"),
    (changed("annotations", 1, bbox=[1, 2, 3]), r"bbox is \[1, 2, 3\], expected \[x, y, width, height\]"),
    (changed("annotations", 1, bbox=[1, 2, 3, "4"]), "bbox has '4', expected a finite number"),
    (changed("annotations", 1, bbox=[1, 2, 3, -4]), "a right or lower edge before the other"),
    (changed("annotations", 1, score="high"), "score has 'high', expected a finite number"),
    (changed("categories", 0, name=""), r"categories\[0\]: name is '', expected a text"),
]


@pytest.mark.parametrize(("write", "message"), BAD, ids=[message[:40] for _, message in BAD])
def test_a_bad_table_is_one_clear_line(tmp_path: Path, write: Callable[[Path], Path], message: str) -> None:
    path = write(tmp_path)
    with pytest.raises(BadInput, match=message) as failure:
        BoxTable2d(str(path), SmallDrive())  # type: ignore[arg-type]
    assert "\n" not in str(failure.value) and str(path) in str(failure.value)


def test_a_damaged_parquet_file_is_one_clear_line(tmp_path: Path) -> None:
    path = parquet(tmp_path)
    content = path.read_bytes()
    for end in range(0, len(content), 97):
        path.write_bytes(content[:end])
        with pytest.raises(BadInput, match=r"boxes\.parquet"):
            read_boxes(path)


@pytest.mark.parametrize("name", ["", "nothing.parquet"])
def test_no_file_is_one_clear_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput, match="expected a file of boxes"):
        files(str(tmp_path / name) if name else "")


def test_another_ending_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "boxes.csv"
    path.write_text("segment")
    with pytest.raises(BadInput, match=r"ends with \.parquet or \.json"):
        BoxTable2d(str(path), SmallDrive())  # type: ignore[arg-type]
