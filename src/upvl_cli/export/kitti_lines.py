"""The lines of KITTI's label files: 15 columns of one box, a score as the 16th."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes
from upvl_cli.export.kitti_axes import KittiColumns
from upvl_cli.export.text import floats_of, read_text
from upvl_cli.types import Array

COLUMNS = 15  # type, truncated, occluded, alpha, rectangle (4), size (3), location (3), rotation_y
_OCCLUSION_UNKNOWN = "3"
_NO_OBJECT = "DontCare"


def label_lines(boxes: ExportBoxes, labels: KittiColumns) -> list[str]:
    """Return the line of each box, with its score as the last column.

    Millionths: KITTI's own files have hundredths, which would move a box by 5 mm.
    """
    numbers = np.column_stack(
        [
            labels.alpha_rad,
            labels.xyxy_px,
            labels.size_hwl_m,
            labels.bottom_m,
            labels.rotation_y_rad,
            boxes.score,
        ]
    )
    return [
        f"{name} {truncated:.2f} {_OCCLUSION_UNKNOWN} " + " ".join(f"{value:.6f}" for value in row)
        for name, truncated, row in zip(boxes.class_name, labels.truncated, numbers, strict=True)
    ]


def read_lines(path: Path, leading: int) -> tuple[list[list[str]], list[str], Array, Array]:
    """Return what the lines of a file say, those of no object left out.

    Args:
        path: The file.
        leading: Columns before those of the box, as the tracking format has them.

    Returns:
        The leading words of each line, the class, (n, 7) size, bottom and rotation_y, and (n,) the score.

    Raises:
        BadInput: A line is no label.
    """
    heads: list[list[str]] = []
    names: list[str] = []
    columns: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        if len(words) not in (leading + COLUMNS, leading + COLUMNS + 1):
            raise BadInput(
                f"{path}, line {number} has {len(words)} columns; expected {leading + COLUMNS} and perhaps a score"
            )
        name, values = words[leading], floats_of(words[leading + 1 :], path, number)
        if name == _NO_OBJECT:
            continue
        heads.append(words[:leading])
        names.append(name)
        columns.append([*values[7:14], values[14] if len(values) > COLUMNS - 1 else 1.0])
    table = np.array(columns, dtype=np.float64).reshape(-1, 8)
    if not np.isfinite(table).all() or (table[:, :3] <= 0).any():
        raise BadInput(f"{path} has a box without a size or a place; expected finite numbers")
    return heads, names, table[:, :7], table[:, 7]
