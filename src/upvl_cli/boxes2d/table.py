"""Boxes of any detector as a table: a Parquet file, or JSON in the form of COCO."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.boxes2d.base import CameraPicture
from upvl_cli.boxes2d.coco_json import read_coco
from upvl_cli.boxes2d.stored import StoredBoxes
from upvl_cli.datasets.shared.arrow import integers, read_parquet, texts, values
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Bools, Boxes2d, Camera, Drive

_EDGES = ("x1", "y1", "x2", "y2")
_OUTSIDE_PX = 1.0  # edges that detectors put beyond the border of a picture by rounding


def files(path: str) -> tuple[Path, ...]:
    """Return the file of the table.

    Raises:
        BadInput: There is no such file.
    """
    table = Path(path).expanduser()
    if not path or not table.is_file():
        raise BadInput(
            f'boxes2d.toml: detector = "table:{path}": expected a file of boxes (.parquet or .json)'
        )
    return (table,)


def read_boxes(path: Path) -> StoredBoxes:
    """Return all boxes of a Parquet file with one row a box, or of a JSON file in the form of COCO.

    Raises:
        BadInput: The file is neither, lacks a column, or holds a value that no box can have.
    """
    if path.suffix == ".json":
        stored = read_coco(path)
    elif path.suffix == ".parquet":
        stored = _read_table(path)
    else:
        raise BadInput(f"{path}: expected a file of boxes that ends with .parquet or .json")
    _check(stored, path)
    return stored


def _read_table(path: Path) -> StoredBoxes:
    table = read_parquet(path, ("segment", "frame", "camera", *_EDGES, "name"), ("score",))
    total = table.num_rows
    return StoredBoxes(
        segment=np.array(texts(table, "segment", path), dtype=np.str_),
        frame=integers(table, "frame", path),
        camera=np.array(texts(table, "camera", path), dtype=np.str_),
        edges_px=np.column_stack([values(table, name, "float64", path) for name in _EDGES]),
        score=values(table, "score", "float64", path) if "score" in table.column_names else np.ones(total),
        name=np.array(texts(table, "name", path), dtype=np.str_),
    )


def _check(stored: StoredBoxes, path: Path) -> None:
    faults = (
        (~np.isfinite(stored.edges_px).all(axis=1), "edges that are not finite"),
        (
            (stored.edges_px[:, :2] > stored.edges_px[:, 2:]).any(axis=1),
            "a right or lower edge before the other",
        ),
        (~((stored.score >= 0) & (stored.score <= 1)), "a score that is not between 0 and 1"),
        (stored.name == "", "no name"),
    )
    for is_bad, fault in faults:
        if is_bad.any():
            row = int(is_bad.argmax())
            values_of_box = ", ".join(f"{value:g}" for value in (*stored.edges_px[row], stored.score[row]))
            raise BadInput(
                f"{path}: box {row} has {fault} (x1, y1, x2, y2, score = {values_of_box}; {is_bad.sum()} such boxes); "
                "expected pixels from the upper left corner of the picture"
            )


@dataclass(frozen=True)
class _Keys:
    """Where the boxes of a drive stand among those that were read."""

    camera: Array
    frame: Array


class BoxTable2d:
    """The boxes of one drive from a table (a `BoxSource2d`)."""

    def __init__(self, path: str, drive: Drive) -> None:
        """Read the table, and keep what is of this drive.

        Args:
            path: The file.
            drive: The drive.

        Raises:
            BadInput: The table has no box of the drive, or none of its cameras.
        """
        (file,) = files(path)
        stored = read_boxes(file)
        here = stored[stored.segment == drive.name]
        if not len(here):
            raise BadInput(
                f"{file}: has no box of the drive {drive.name}; it has {_few(stored.segment)}; expected the names that "
                "upvl segments prints"
            )
        cameras = {camera.name: camera for camera in drive.cameras}
        is_of_camera = np.isin(here.camera, list(cameras))
        if not is_of_camera.any():
            raise BadInput(
                f"{file}: has boxes of {drive.name} in {_few(here.camera)}; expected its cameras: "
                f"{', '.join(cameras) or 'it has none'}"
            )
        is_of_frame = np.isin(here.frame, [frame.index for frame in drive.frames])
        self.dropped = Counter[str]()
        if not is_of_camera.all():
            self.dropped["boxes of cameras that the drive has not"] = int((~is_of_camera).sum())
        if not is_of_frame.all():
            self.dropped["boxes of frames that the drive has not"] = int((is_of_camera & ~is_of_frame).sum())
        kept = here[is_of_camera & is_of_frame]
        _check_inside(kept, cameras, file)
        self._boxes = Boxes2d(kept.edges_px - 0.5, kept.score, kept.name)
        self._keys = _Keys(kept.camera, kept.frame)

    def boxes(self, picture: CameraPicture) -> Boxes2d:
        """Return the boxes of a picture in the order of the table."""
        is_here: Bools = (self._keys.frame == picture.frame) & (self._keys.camera == picture.camera)
        return self._boxes[is_here]


def _check_inside(stored: StoredBoxes, cameras: dict[str, Camera], path: Path) -> None:
    """Refuse boxes in the pixels of a picture of another size."""
    for name, camera in cameras.items():
        edges_px = stored.edges_px[stored.camera == name]
        limit = np.array([camera.width_px, camera.height_px] * 2) + _OUTSIDE_PX
        if ((edges_px < -_OUTSIDE_PX) | (edges_px > limit)).any():
            low, high = edges_px.min(axis=0), edges_px.max(axis=0)
            raise BadInput(
                f"{path}: boxes of {camera.name} reach from ({low[0]:g}, {low[1]:g}) to ({high[2]:g}, {high[3]:g}), "
                f"but its pictures have {camera.width_px} x {camera.height_px} px; expected pixels of these"
            )


def _few(names: Sequence[str] | Array) -> str:
    known = sorted(set(map(str, names)))
    return f"{', '.join(known[:5])}{', ...' if len(known) > 5 else ''}" or "no box at all"
