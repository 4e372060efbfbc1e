"""Pose files as SLAM tools, data sets and ROS write them: TUM, KITTI, and CSV with a header in many spellings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.datasets.recordings.stamps import parse_stamps
from upvl_cli.datasets.shared.content import read_text
from upvl_cli.datasets.shared.poses import check_pose, quaternion_rotation, rigid
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

_SPLIT = re.compile(r"[,;\s]+")
_UNIT = re.compile(r"\[.*?\]|\(.*?\)|\{.*?\}")
_IGNORED = {
    "field",
    "pose",
    "header",
    "m",
    "rs",
    "r",
    "s",
    "transform",
    "odom",
    "gt",
    "rad",
    "rosbagtimestamp",
}
_TIME = {"t", "time", "timestamp", "stamp", "timens", "timestampns", "timeus", "times", "sec", "secs", "seconds",
         "timestamps", "timestampsec", "timesec"}  # fmt: skip
_POSITION = ("", "p", "t", "pos", "position", "translation", "location")
_QUATERNION = ("q", "quat", "quaternion", "orientation", "rotation", "rot")
_ANGLES = ("roll", "pitch", "yaw")
_EXPECTED = (
    "TUM lines (t x y z qx qy qz qw), KITTI lines (12 numbers, a 3 x 4 matrix), or CSV with a header such as "
    "time,x,y,z,qx,qy,qz,qw"
)


@dataclass(frozen=True, eq=False)
class PoseTable:
    """The poses of a file.

    Attributes:
        form: What the file is, for people: "TUM", "KITTI" or "CSV".
        times_ns: (n,) int64 times, or None where the file has none.
        poses: (n, 4, 4) world_from_sensor.
    """

    form: str
    times_ns: Array | None
    poses: Array


def read_poses(path: Path) -> PoseTable:
    """Return the poses of a file.

    Args:
        path: The file.

    Raises:
        BadInput: It is of no known form, or a row is no pose.
    """
    lines = [line.strip() for line in read_text(path).splitlines()]
    rows = [_SPLIT.split(line.strip(",; \t")) for line in lines if line and not line.startswith(("#", "%"))]
    header = next((line.lstrip("#% ") for line in lines if line), "")
    is_named = len(_SPLIT.split(header)) > 2 and not any(map(_is_number, _SPLIT.split(header)))
    if is_named and ("," in header or ";" in header or not lines[0].startswith(("#", "%"))):
        separator = ";" if header.count(";") > header.count(",") else "," if "," in header else None
        cells = [[cell.strip() for cell in line.split(separator)] for line in lines if line]
        names = [name.strip().lstrip("#% ") for name in header.split(separator)]
        body = [row for row in cells[1:] if not row[0].startswith(("#", "%"))]
        return _named(names, body, path)
    if not rows:
        raise BadInput(f"{path} holds no pose; expected {_EXPECTED}")
    width = len(rows[0])
    wrong = next((place for place, row in enumerate(rows) if len(row) != width), None)
    if wrong is not None:
        raise BadInput(
            f"{path}: row {wrong + 1} has {len(rows[wrong])} columns and the first {width}; mend it"
        )
    if width in (8, 13, 17):
        times = np.array(parse_stamps([row[0] for row in rows], path), dtype=np.int64)
        values = _numbers([row[1:] for row in rows], path)
        return PoseTable("TUM" if width == 8 else "KITTI with times", times, _poses(values, path))
    if width in (7, 12, 16):
        form = "poses without times" if width == 7 else "KITTI"
        return PoseTable(form, None, _poses(_numbers(rows, path), path))
    raise BadInput(f"{path} has {width} columns; expected {_EXPECTED}")


def read_matrix(path: Path) -> Array:
    """Return the (4, 4) rigid transform of a file that holds 12 or 16 numbers."""
    words = read_text(path).replace(",", " ").replace("[", " ").replace("]", " ").split()
    if len(words) not in (12, 16):
        raise BadInput(f"{path} holds {len(words)} words; expected 12 or 16 numbers: a 3 x 4 or 4 x 4 matrix")
    return np.asarray(_poses(_numbers([words], path), path)[0])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(rows: Sequence[Sequence[str]], path: Path) -> Array:
    """Return (n, k) float64; raises `BadInput` with the row that is not all numbers."""
    values = np.empty((len(rows), len(rows[0]) if rows else 0))
    for place, row in enumerate(rows):
        try:
            values[place] = [float(word) for word in row]
        except ValueError:
            values[place] = np.nan
        if not np.isfinite(values[place]).all():
            raise BadInput(
                f"{path}: pose number {place + 1} is {' '.join(row)[:80]!r}; expected finite numbers"
            )
    return values


def _poses(values: Array, path: Path) -> Array:
    """Return (n, 4, 4) of (n, 7) x y z qx qy qz qw, or of (n, 12 or 16) rows of a matrix."""
    where = f"{path}: pose"
    if values.shape[1] == 7:
        quat_wxyz = values[:, [6, 3, 4, 5]]
        return check_pose(rigid(quaternion_rotation(quat_wxyz, where), values[:, :3]), where)
    return check_pose(values.reshape(len(values), -1, 4), where)


def _named(names: Sequence[str], rows: Sequence[Sequence[str]], path: Path) -> PoseTable:
    """Return the poses of columns with names."""
    keys = [_key(name) for name in names]
    wrong = next((place for place, row in enumerate(rows) if len(row) < len(keys)), None)
    if wrong is not None:
        raise BadInput(
            f"{path}: row {wrong + 1} has {len(rows[wrong])} columns and its header {len(keys)}; mend it"
        )
    position = [_column(keys, [prefix + axis for prefix in _POSITION]) for axis in "xyz"]
    quaternion = [_column(keys, [prefix + axis for prefix in _QUATERNION]) for axis in "wxyz"]
    angles = [_column(keys, [name, f"{name}deg"]) for name in _ANGLES]
    if not rows or None in position[:2] or (None in quaternion and angles[2] is None):
        raise BadInput(
            f"{path} has {len(rows)} rows of the columns {', '.join(names)[:200]}; expected {_EXPECTED}"
        )
    place_m = np.column_stack([_cells(rows, column, path) for column in position])
    if None not in quaternion:
        quat_wxyz = np.column_stack([_cells(rows, column, path) for column in quaternion])
        rotation = quaternion_rotation(quat_wxyz, f"{path}: pose")
    else:
        turns = np.column_stack([_cells(rows, column, path) for column in angles])
        in_degrees = any("deg" in name.lower() for name in names)
        rotation = Rotation.from_euler("xyz", turns, degrees=in_degrees).as_matrix()
    times = _times(keys, rows, path)
    return PoseTable("CSV", times, check_pose(rigid(rotation, place_m), f"{path}: pose"))


def _times(keys: Sequence[str], rows: Sequence[Sequence[str]], path: Path) -> Array | None:
    second, nano = (
        _column(keys, ["sec", "secs", "stampsec", "stampsecs"]),
        _column(keys, ["nanosec", "nsec", "nsecs", "stampnanosec", "stampnsec", "stampnsecs", "nanosecs"]),
    )
    if second is not None and nano is not None:
        texts = [f"{row[second]}.{row[nano].rjust(9, '0')}" for row in rows]
    else:
        column = _column(keys, sorted(_TIME))
        if column is None:
            return None
        texts = [row[column] for row in rows]
    return np.array(parse_stamps(texts, path), dtype=np.int64)


def _key(name: str) -> str:
    tokens = re.findall(r"[a-z]+", _UNIT.sub("", name.lower()))
    kept = [token for token in tokens if token not in _IGNORED]
    return "".join(kept or tokens)


def _column(keys: Sequence[str], names: Sequence[str]) -> int | None:
    return next((keys.index(name) for name in names if name in keys), None)


def _cells(rows: Sequence[Sequence[str]], column: int | None, path: Path) -> Array:
    if column is None:
        return np.zeros(len(rows))
    return _numbers([[row[column]] for row in rows], path)[:, 0]
