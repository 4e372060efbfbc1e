"""KITTI's object labels of single frames (`object_label_2/*.txt`), which are in camera axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from upvl_cli.datasets.kitti.text import numbers, read_text
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, wrap_angle
from upvl_cli.types import Array, Boxes

# After the class: truncated, occluded, alpha, the image box (4), h, w, l, x, y, z, rotation_y.
_FIELDS = 14
_MOST_M = 1e4  # a LiDAR sees a few hundred metres


def read_objects(path: Path, ego_from_rect: Array) -> tuple[list[str], Boxes]:
    """Return the classes and the boxes in ego axes of the objects of a frame, without `DontCare`.

    Args:
        path: One line an object; the place is the middle of the floor of its box.
        ego_from_rect: (4, 4) pose of the rectified reference camera, in whose axes the boxes are.

    Raises:
        BadInput: A line is not what it has to be.
    """
    class_names, rows = [], []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        class_name, _, text = line.strip().partition(" ")
        if class_name and class_name != "DontCare":
            values = numbers(text, _FIELDS, f"{path}, line {number}")
            if not (values[7:10] > 0).all():
                raise BadInput(f"{path}, line {number}: height, width, length {values[7:10]} must be above 0")
            if not np.abs(values[7:13]).max() <= _MOST_M:
                raise BadInput(
                    f"{path}, line {number}: size and place {values[7:13].tolist()} must be within "
                    f"{_MOST_M:g} m; copy the file again"
                )
            class_names.append(class_name)
            rows.append(values)
    return class_names, _boxes(np.array(rows).reshape(-1, _FIELDS), ego_from_rect)


def _boxes(values: Array, ego_from_rect: Array) -> Boxes:
    height_m, width_m, length_m = values[:, 7:10].T
    rotation_y = values[:, 13]
    centre = values[:, 10:13].copy()
    centre[:, 1] -= height_m / 2  # y points down
    zero = np.zeros(len(values))
    along = np.stack([np.cos(rotation_y), zero, -np.sin(rotation_y)], axis=1) @ ego_from_rect[:3, :3].T
    heading = np.arctan2(along[:, 1], along[:, 0])
    size_lwh_m = np.column_stack([length_m, width_m, height_m])
    return Boxes(apply(ego_from_rect, centre), size_lwh_m, wrap_angle(heading))
