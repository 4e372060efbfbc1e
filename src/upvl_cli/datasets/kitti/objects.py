"""KITTI's object labels, one line a box in camera axes: files of single frames, and of whole tracking sequences."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.numbers import numbers
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, wrap_angle
from upvl_cli.types import Array, Boxes

# After the class: truncated, occluded, alpha, the image box (4), h, w, l, x, y, z, rotation_y; then perhaps a score.
_FIELDS = 14
_MOST_M = 1e4  # a LiDAR sees a few hundred metres
_IGNORED = "DontCare"


@dataclass(frozen=True)
class ObjectBoxes:
    """The n labelled objects of a file, without `DontCare`.

    Attributes:
        class_names: Their classes.
        boxes: Their boxes in ego axes.
        frames: (n,) the frame of each; 0 in a file of one frame.
        ids: (n,) the number of the object, by line in a file of one frame.
    """

    class_names: list[str]
    boxes: Boxes
    frames: Array
    ids: Array


def read_objects(path: Path, ego_from_rect: Array, *, turns_about_lidar: bool = False) -> ObjectBoxes:
    """Return the objects of a frame.

    Args:
        path: One line an object; the place is the middle of the floor of its box.
        ego_from_rect: (4, 4) pose of the rectified reference camera, in whose axes the boxes are.
        turns_about_lidar: Whether boxes are turned about the LiDAR's z axis downward, as View-of-Delft has them,
            instead of the camera's y axis.

    Raises:
        BadInput: A line is not what it has to be.
    """
    rows, class_names = [], []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        class_name, _, text = line.strip().partition(" ")
        if class_name and class_name != _IGNORED:
            rows.append(_read_box(text, f"{path}, line {number}"))
            class_names.append(class_name)
    boxes = _boxes(np.array(rows).reshape(-1, _FIELDS), ego_from_rect, turns_about_lidar)
    return ObjectBoxes(class_names, boxes, np.zeros(len(boxes), dtype=int), np.arange(len(boxes)))


def read_sequence_objects(path: Path, ego_from_rect: Array) -> ObjectBoxes:
    """Return the objects of a tracking sequence, whose lines begin with the frame and the number of the object.

    Args:
        path: One line an object and frame.
        ego_from_rect: (4, 4) pose of the rectified reference camera, in whose axes the boxes are.

    Raises:
        BadInput: A line is not what it has to be, or an object has two boxes in one frame.
    """
    rows, class_names, keys = [], [], []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        where = f"{path}, line {number}"
        words = line.split(maxsplit=3)
        if not words or words[2:3] == [_IGNORED]:
            continue
        if len(words) < 4:
            raise BadInput(
                f"{where} holds {line.strip()[:80]!r}; expected frame, track, class and 14 numbers"
            )
        key = numbers(" ".join(words[:2]), 2, where)
        if not (key == np.round(key)).all() or not (np.abs(key) < 1e9).all() or key[0] < 0:
            raise BadInput(f"{where} begins with {words[0]} {words[1]}; expected a frame and a track number")
        rows.append(_read_box(words[3], where))
        class_names.append(words[2])
        keys.append((int(key[0]), int(key[1])))
    if len(set(keys)) < len(keys):
        frame, track = next(key for place, key in enumerate(keys) if key in keys[:place])
        raise BadInput(f"{path}: track {track} has two boxes in frame {frame}; copy the file again")
    boxes = _boxes(np.array(rows).reshape(-1, _FIELDS), ego_from_rect, False)
    frames, ids = np.array(keys, dtype=np.int64).reshape(-1, 2).T
    return ObjectBoxes(class_names, boxes, frames, ids)


def _read_box(text: str, where: str) -> Array:
    """Return the 14 numbers after the class."""
    has_score = len(text.split()) == _FIELDS + 1
    values = numbers(text, _FIELDS + has_score, where)[:_FIELDS]
    if not (values[7:10] > 0).all():
        raise BadInput(f"{where}: height, width, length {values[7:10]} must be above 0")
    if not np.abs(values[7:14]).max() <= _MOST_M:
        raise BadInput(
            f"{where}: size, place and angle {values[7:14].tolist()} must be within {_MOST_M:g} m; "
            "copy the file again"
        )
    return values


def _boxes(values: Array, ego_from_rect: Array, turns_about_lidar: bool) -> Boxes:
    height_m, width_m, length_m = values[:, 7:10].T
    rotation_y = values[:, 13]
    centre = values[:, 10:13].copy()
    size_lwh_m = np.column_stack([length_m, width_m, height_m])
    if turns_about_lidar:
        center_m = apply(ego_from_rect, centre)
        center_m[:, 2] += height_m / 2
        return Boxes(center_m, size_lwh_m, wrap_angle(-rotation_y - np.pi / 2))
    centre[:, 1] -= height_m / 2  # y points down
    zero = np.zeros(len(values))
    along = np.stack([np.cos(rotation_y), zero, -np.sin(rotation_y)], axis=1) @ ego_from_rect[:3, :3].T
    heading = np.arctan2(along[:, 1], along[:, 0])
    return Boxes(apply(ego_from_rect, centre), size_lwh_m, wrap_angle(heading))
