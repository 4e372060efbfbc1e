"""What the formats of annotation tools share: names of frames, numbers beside a box, and boxes as they are found."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive, boxes_of_rows, track_numbers
from upvl_cli.types import Array

VELOCITY = ("velocity_x_mps", "velocity_y_mps", "velocity_z_mps")
NUMBERS = ("score", *VELOCITY, "num_points")  # as attributes of a box, in tools that know any
_MOST_COUNT = 1e9  # points of a box


def frame_name(index: int) -> str:
    """Return the name of a frame's files, without its ending: names sort as the frames do."""
    return f"{index:010d}"


def frame_of_name(name: str, where: str) -> int:
    """Return the index of the frame whose files have this name, without an ending.

    Raises:
        BadInput: The name is no number of a frame.
    """
    if not (name.isascii() and name.isdigit() and len(name) < 16):
        raise BadInput(f"{where}: {name[:60]!r} is no frame; expected its number, as in {frame_name(7)}")
    return int(name)


def write_json(path: Path, content: Any, indent: int | None = None) -> None:
    """Write JSON; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    separators = (",", ":") if indent is None else None
    text = json.dumps(content, indent=indent, separators=separators, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def xyz_object(values: Array) -> dict[str, float]:
    """Return three numbers as x, y and z."""
    return dict(zip("xyz", map(float, values), strict=True))


def boxes_of_frame(drive: ExportDrive, index: int) -> ExportBoxes:
    """Return the boxes of a frame; those of a drive are by ascending frame."""
    first, end = np.searchsorted(drive.boxes.frame, [index, index + 1])
    return drive.boxes[first:end]


def numbers_beside(boxes: ExportBoxes, i: int) -> dict[str, float]:
    """Return score, velocity (ego axes, m/s) and number of points of a box, those that are known."""
    values = [boxes.score[i], *boxes.velocity_mps[i]]
    known = {
        name: float(value) for name, value in zip(NUMBERS[:4], values, strict=True) if np.isfinite(value)
    }
    return known | ({"num_points": int(boxes.num_points[i])} if boxes.num_points[i] >= 0 else {})


def drive_folders(
    folder: Path, drives: Mapping[str, ExportDrive], holds: str, prefix: str = ""
) -> Iterator[tuple[str, Path, ExportDrive]]:
    """Yield name, folder and drive of each folder that bears the name of a drive and holds a file or folder.

    What a tool exports of one drive is often not in such a folder: where the whole is the folder of one drive, by
    its name or because the workspace has but one, it is taken as that drive.

    Args:
        folder: What is read.
        drives: The drives that are known.
        holds: Name of a file or folder of every drive.
        prefix: What folders have before the name of the drive; one without it counts too.
    """
    if (folder / holds).exists():
        own_name = folder.name.removeprefix(prefix)
        names = [own_name] if own_name in drives else list(drives)
        if len(names) == 1:
            yield names[0], folder, drives[names[0]]
            return
        raise BadInput(
            f"{folder} holds {holds} of one drive, and does not say of which; put it into a folder that bears the "
            "name of the drive"
        )
    for name, drive in drives.items():
        candidates = [folder / f"{prefix}{name}", folder / name]
        own = next((path for path in candidates if (path / holds).exists()), None)
        if own is not None:
            yield name, own, drive


@dataclass
class FoundBoxes:
    """The boxes of a drive as a file gives them, one after the other."""

    _rows: list[Sequence[float]] = field(default_factory=list)
    _frames: list[int] = field(default_factory=list)
    _tracks: list[str] = field(default_factory=list)
    _names: list[str] = field(default_factory=list)
    _others: list[Mapping[str, float]] = field(default_factory=list)

    def add(
        self, frame: int, track: str | None, name: str, row: Sequence[float], others: Mapping[str, float]
    ) -> None:
        """Add a box.

        Args:
            frame: Index of its frame.
            track: What names its object; None for an object of its own.
            name: Its class.
            row: x, y, z, length, width, height (m), heading (rad), in ego axes.
            others: What of `NUMBERS` is known.
        """
        self._rows.append(row)
        self._frames.append(frame)
        self._tracks.append(f"box {len(self._tracks)}" if track is None else track)
        self._names.append(name)
        self._others.append(others)

    def boxes(self) -> ExportBoxes:
        """Return all of them."""
        counts = [other.get("num_points", -1) for other in self._others]
        return boxes_of_rows(
            np.array(self._rows, dtype=np.float64).reshape(-1, 7),
            frame=np.array(self._frames, dtype=np.int64),
            track_id=track_numbers(self._tracks),
            class_name=np.array(self._names, dtype=str),
            score=np.array([other.get("score", 1.0) for other in self._others]),
            velocity_mps=np.array(
                [[other.get(name, math.nan) for name in VELOCITY] for other in self._others]
            ),
            num_points=np.array([int(n) if 0 <= n < _MOST_COUNT else -1 for n in counts], dtype=np.int64),
        )
