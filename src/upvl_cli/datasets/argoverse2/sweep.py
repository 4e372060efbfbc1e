"""One sweep of both LiDARs: already in ego axes, and compensated for the motion of the car up to its own time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.arrow import read_feather, values
from upvl_cli.datasets.shared.point_files.scan import scan_points
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Points

_LASERS_OF_UP = 32  # lasers 0 to 31 are those of up_lidar, 32 to 63 those of down_lidar
_MAX_LASER = 63
_MAX_INTENSITY = 255
_MAX_OFFSET_NS = 1_000_000_000  # a turn takes a tenth of it
_COLUMNS = {
    "x": "float64",
    "y": "float64",
    "z": "float64",
    "intensity": "float32",
    "laser_number": "int64",
    "offset_ns": "int64",
}


def read_sweep(path: Path) -> tuple[Points, Mapping[str, int]]:
    """Return the points of a sweep, and how many rows were left out, by reason.

    `sensor` is 0 for up_lidar and 1 for down_lidar.

    Raises:
        BadInput: The file cannot be read, or is no sweep.
    """
    table = read_feather(path, tuple(_COLUMNS))
    columns = {name: values(table, name, dtype, path) for name, dtype in _COLUMNS.items()}
    _check_range(columns["intensity"], 0, _MAX_INTENSITY, "intensity", path)
    _check_range(columns["laser_number"], 0, _MAX_LASER, "laser_number", path)
    _check_range(columns["offset_ns"], -_MAX_OFFSET_NS, _MAX_OFFSET_NS, "offset_ns", path)
    scan = scan_points(columns, "Feather", str(path))
    total = len(scan)
    laser, intensity, offset_ns = (
        np.zeros(total) if column is None else column for column in (scan.ring, scan.intensity, scan.time)
    )
    points = Points(
        xyz_ego_m=scan.xyz_m,
        intensity=intensity / np.float32(_MAX_INTENSITY),
        elongation=np.zeros(total, np.float32),
        sensor=laser >= _LASERS_OF_UP,
        time_offset_ns=offset_ns,
    )
    return points, scan.skipped


def _check_range(column: Array, low: int, high: int, name: str, path: Path) -> None:
    wrong = np.flatnonzero(~((column >= low) & (column <= high)))
    if len(wrong):
        raise BadInput(
            f"{path}: {name} of row {wrong[0]} is {column[wrong[0]]:g}, expected {low} to {high}; copy it again"
        )
