"""One sweep of KITTI's, whole or refused, and what a few of a drive say of its car and its sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from upvl_cli.datasets.shared.content import read_bytes
from upvl_cli.datasets.shared.point_files.bin import RowLayout, read_bin, recognise_rows
from upvl_cli.datasets.shared.point_files.read import parse_points
from upvl_cli.datasets.shared.point_files.scan import MOST_M
from upvl_cli.errors import BadInput
from upvl_cli.geometry.road_height import road_height_m
from upvl_cli.types import Array

_ROWS = RowLayout("<f4", 4)  # x, y, z, reflectance
_PLACES = RowLayout("<f4", 3)  # as some tools write it, without reflectance

LIDAR_HEIGHT_M = 1.73  # the Velodyne above the road: Geiger et al., IJRR 2013, figure 3
_SAME_CAR_M = 0.3  # the measured height of another car's LiDAR differs by more, or nothing shows it
# A drive of KITTI's own name may stand on a slope; axes that were moved, say to the road, differ by more.
_SAME_AXES_M = 1.2
# KITTI's car around its LiDAR, with the rack whose tips return up to 1.5 m to each side (seen in drive 0001):
# what is measured in there moves as the car does, and is the car.
_CAR_X_M, _CAR_Y_M = (-2.3, 3.0), (-1.6, 1.6)
_MEASURED_SWEEPS = 5  # over the drive: a slope or a queue of cars around one of them decides nothing


def read_sweep(path: Path) -> tuple[Array, Mapping[str, int]]:
    """Return (n, 4) float32 x, y, z and reflectance of a `.bin`, and how many rows were left out, by reason.

    Reflectance is 0 in a file of places alone. Left out are rays without return (NaN).

    Raises:
        BadInput: The file is missing, cut off, or holds anything else; the message names what.
    """
    content = read_bytes(path)
    found = recognise_rows(content)
    if found == _ROWS and len(content) % _ROWS.row_bytes == 0:
        values = np.frombuffer(content, dtype=_ROWS.dtype).reshape(-1, 4)
        # One pass over what is nearly always in order; NaN fails every comparison.
        if np.abs(values).max() <= MOST_M:
            return values, {}
    if found == _PLACES and len(content) % _PLACES.row_bytes == 0:
        points = read_bin(content, 3, str(path))
    else:
        points = parse_points(content, 4, str(path))
    reflectance = np.zeros(len(points)) if points.intensity is None else points.intensity
    return np.column_stack([points.xyz_m, reflectance]).astype(np.float32), points.skipped


@dataclass(frozen=True)
class Vehicle:
    """The car of a drive and the scale of its LiDAR, as far as sweeps show them.

    Attributes:
        ground_z_m: Height of the road in ego axes.
        has_outline: Whether it is KITTI's car, whose outline around the LiDAR is known.
        full_reflectance: The reflectance that counts as 1.
    """

    ground_z_m: float
    has_outline: bool
    full_reflectance: float


def measure_vehicle(sweeps: Sequence[Path], *, is_kittis: bool | None) -> Vehicle:
    """Return what a few sweeps over a drive say of the car and the sensor.

    Args:
        sweeps: The files of the drive, in order.
        is_kittis: Whether the drive says that the car is KITTI's; None where it says nothing. Either way the height of
            that car's LiDAR counts only where the road is measured there: z may be shifted.
    """
    chosen = np.unique(np.linspace(0, len(sweeps) - 1, _MEASURED_SWEEPS).astype(int))
    heights_m, largest = [], 0.0
    for path in (sweeps[place] for place in chosen):
        try:
            values, _ = read_sweep(path)
        except BadInput:  # reading that sweep says so
            continue
        if len(values):
            heights_m.append(road_height_m(values[:, :3]))
            largest = max(largest, float(values[:, 3].max()))
    ground_z_m = float(np.median(heights_m)) if heights_m else -LIDAR_HEIGHT_M
    off_m = abs(ground_z_m + LIDAR_HEIGHT_M)
    has_height = off_m <= (_SAME_CAR_M if is_kittis is None else _SAME_AXES_M) and is_kittis is not False
    return Vehicle(
        ground_z_m=-LIDAR_HEIGHT_M if has_height else ground_z_m,
        has_outline=has_height or is_kittis is True,
        full_reflectance=_full_reflectance(largest),
    )


def _full_reflectance(largest: float) -> float:
    """Return the end of the scale: 1 as KITTI has it, or the largest number of 8 or 16 bits."""
    return next((full for full in (1.0, 255.0, 65535.0) if largest <= full), largest)


def without_car(values: Array, vehicle: Vehicle) -> Array:
    """Return the points of a sweep, (n, 4), that do not lie on the car that carries the LiDAR."""
    if not vehicle.has_outline:
        return np.asarray(values.take(np.flatnonzero(values[:, :3].any(axis=1)), axis=0))
    x_m, y_m = values[:, 0], values[:, 1]
    along = (x_m > _CAR_X_M[0]) & (x_m < _CAR_X_M[1])
    on_car = along & (y_m > _CAR_Y_M[0]) & (y_m < _CAR_Y_M[1])
    return np.asarray(values.take(np.flatnonzero(~on_car), axis=0))


def reflectance(values: Array, vehicle: Vehicle) -> Array:
    """Return (n,) float32 reflectances from 0 to 1 of a sweep."""
    scaled = (
        values[:, 3] if vehicle.full_reflectance == 1 else values[:, 3] / np.float32(vehicle.full_reflectance)
    )
    return np.clip(scaled, 0, 1)
