"""The height of the ground in the city, on a grid of 0.3 m cells."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.datasets.shared.content import read_bytes, read_json
from upvl_cli.datasets.shared.paths import find
from upvl_cli.datasets.shared.poses import ROTATION_TOLERANCE
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply
from upvl_cli.types import Array, Floats

HEIGHTS, GRID = "map/*_ground_height_surface____*.npy", "map/*___img_Sim2_city.json"
_NPY = re.compile(rb"\x93NUMPY[\x01-\x03]\x00")
_FIELD = re.compile(r"'(descr|fortran_order|shape)'\s*:\s*('[^']*'|True|False|\([0-9, ]*\))")
_MAX_M = 1e6
_MAX_HEADER_BYTES = 10_000


@dataclass(frozen=True, eq=False)
class GroundHeights:
    """Heights on a grid over the city.

    Attributes:
        height_m: (rows, columns) height of the ground, along the z axis of the city; NaN where unknown.
        turn: (2, 2) rotation from the axes of the city to those of the grid.
        shift_m: (2,) shift that follows the rotation.
        cells_per_m: Scale that follows the shift: then the first coordinate counts columns, the second rows.
    """

    height_m: Floats
    turn: Array
    shift_m: Array
    cells_per_m: float

    def at(self, xy_city_m: Array) -> Floats:
        """Return (n,) heights of the cells that hold (n, 2) places of the city; NaN outside and where unknown."""
        xy_m = np.asarray(xy_city_m, dtype=np.float64)
        place = xy_m[:, :1] * self.turn[:, 0] + xy_m[:, 1:] * self.turn[:, 1]
        place = (place + self.shift_m) * self.cells_per_m
        rows, columns = self.height_m.shape
        with np.errstate(invalid="ignore"):
            inside = (place >= 0).all(axis=1) & (place[:, 0] < columns) & (place[:, 1] < rows)
        cell = place[inside].astype(np.int64)
        height_m = np.full(len(place), np.nan)
        height_m[inside] = self.height_m[cell[:, 1], cell[:, 0]]
        return height_m


def height_files(folder: Path) -> tuple[Path, Path] | None:
    """Return the file of heights and that of the grid of a log; None where it has neither.

    Raises:
        BadInput: It has one of them, or more than one of a kind.
    """
    heights, grids = find(folder, [HEIGHTS]), find(folder, [GRID])
    if not heights and not grids:
        return None
    if len(heights) != 1 or len(grids) != 1:
        raise BadInput(
            f"{folder / 'map'} has {len(heights)} files of ground heights and {len(grids)} of their grid, "
            "expected one of each; copy the map again"
        )
    return heights[0], grids[0]


def read_heights(heights: Path, grid: Path) -> GroundHeights:
    """Return the heights of a log.

    Raises:
        BadInput: A file cannot be read, or is not what it has to be.
    """
    content = read_json(grid)
    content = content if isinstance(content, dict) else {}
    turn, shift, scale = (_numbers(content.get(key)) for key in ("R", "t", "s"))
    if len(turn) != 4 or len(shift) != 2 or len(scale) != 1 or not scale[0] > 0:
        raise BadInput(f"{grid} holds no grid; expected R of 4 numbers, t of 2, and s above 0: copy it again")
    rotation = np.array(turn).reshape(2, 2)
    if np.abs(rotation @ rotation.T - np.eye(2)).max() > ROTATION_TOLERANCE:
        raise BadInput(f"{grid}: R is no rotation; copy it again")
    return GroundHeights(_read_npy(heights), rotation, np.array(shift), scale[0])


def ground_z_ego(heights: GroundHeights, city_from_ego: Array, xyz_ego_m: Array) -> Floats:
    """Return (n,) height of the ground at places, along the z axis of the ego; NaN where unknown.

    Args:
        heights: The grid.
        city_from_ego: (4, 4) where the car is.
        xyz_ego_m: (n, 3) places in ego axes.
    """
    xyz_ego_m = np.asarray(xyz_ego_m, dtype=np.float64)
    xyz_city_m = apply(city_from_ego, xyz_ego_m)
    below_m = xyz_city_m[:, 2] - heights.at(xyz_city_m[:, :2])
    # The car leans by a degree or two: over the height of a point that moves the place by less than a cell.
    return np.asarray(xyz_ego_m[:, 2] - below_m / city_from_ego[2, 2])


def _numbers(value: Any) -> list[float]:
    """Return a number or a list of numbers as a list; empty where it is anything else."""
    listed = value if isinstance(value, list) else [value]
    if not all(isinstance(item, (int, float)) and abs(item) <= _MAX_M for item in listed):
        return []
    return [float(item) for item in listed]


def _read_npy(path: Path) -> Floats:
    """Return the two-dimensional floats of a NumPy file; its header is compared with its size before it counts."""
    content = read_bytes(path)
    wide = content[6:7] != b"\x01"
    start = 12 if wide else 10
    end = start + int.from_bytes(content[8:start], "little")
    header = content[start:end].decode("latin-1") if end <= start + _MAX_HEADER_BYTES else ""
    found = dict(_FIELD.findall(header))
    shape = [int(text) for text in re.findall(r"[0-9]{1,9}", found.get("shape", ""))]
    kind = found.get("descr", "").strip("'")
    if not _NPY.match(content) or kind not in ("<f2", "<f4", "<f8") or len(shape) != 2:
        raise BadInput(f"{path} is no NumPy file of rows and columns of floats; copy it again")
    if len(content) - end != math.prod(shape) * np.dtype(kind).itemsize:
        raise BadInput(
            f"{path} has {len(content) - end} bytes of heights, expected {shape[0]} x {shape[1]} of "
            f"{np.dtype(kind).itemsize}; copy it again"
        )
    cells = np.frombuffer(content, dtype=kind, offset=end)
    is_by_column = found.get("fortran_order") == "True"
    cells = cells.reshape(shape[::-1]).T if is_by_column else cells.reshape(shape)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(np.abs(cells) <= _MAX_M, cells, np.nan).astype(np.float32)
