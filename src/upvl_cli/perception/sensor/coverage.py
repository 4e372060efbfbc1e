"""What the car hides and what of it the LiDARs see: sectors without returns, and points on the car itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.sensor.config import SensorConfig
from upvl_cli.types import Array, Floats

_ROAD_M = 0.3  # points this far above the road are no road
_SAME = 0.8  # of the cells around a car that drives hold points later, at most; around one that stands 0.9
_SCENE_M, _SCENE_CELL_M = (6.0, 25.0), 1.0  # of the cells by which a car is seen to drive
_SCENE_ABOVE_M = 0.8  # slopes and kerbs look the same everywhere
_MIN_SWEEPS = 4
_TRIM = 0.5  # percent of the points of the car that the outline leaves out at each side


@dataclass(frozen=True)
class CarFootprint:
    """Points that stay where they are in ego axes while the car drives: the car itself.

    Attributes:
        x_m: From the back to the front.
        y_m: From the right to the left.
        points: How many a sweep has, by the median.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    points: int


def find_car(sweeps: Sequence[Array], road_z_m: float, config: SensorConfig) -> CarFootprint | None:
    """Return the outline of the car where the sweeps show it, else None.

    Args:
        sweeps: (n, 3) points of each sweep in ego axes, spread over the drive.
        road_z_m: Height of the road in ego axes.
        config: Settings.
    """
    if len(sweeps) < _MIN_SWEEPS or not scene_changes(sweeps, road_z_m):
        return None
    near = [_near(xyz, road_z_m, config) for xyz in sweeps]
    cells = [_cells(xyz, config.car_cell_m) for xyz in near]
    numbers, count = np.unique(np.concatenate([np.unique(each) for each in cells]), return_counts=True)
    fixed = numbers[count >= config.car_share * len(sweeps)]
    on_car = [xyz[np.isin(each, fixed)] for xyz, each in zip(near, cells, strict=True)]
    points = int(np.median([len(xyz) for xyz in on_car]))
    if points < config.min_car_points:
        return None
    every = np.concatenate(on_car)
    low, high = np.percentile(every[:, :2], [_TRIM, 100 - _TRIM], axis=0)
    low, high = np.floor(low * 10) / 10, np.ceil(high * 10) / 10
    return CarFootprint((float(low[0]), float(high[0])), (float(low[1]), float(high[1])), points)


def scene_changes(sweeps: Sequence[Array], road_z_m: float) -> bool:
    """Return whether what stands around the car is elsewhere in the last sweep than in the first.

    Args:
        sweeps: (n, 3) points of each sweep in ego axes.
        road_z_m: Height of the road in ego axes.
    """
    first, last = (
        np.unique(_cells(_around(xyz, road_z_m), _SCENE_CELL_M)) for xyz in (sweeps[0], sweeps[-1])
    )
    return len(first) > 0 and float(np.isin(first, last).mean()) < _SAME


def hidden_sectors(
    azimuth_deg: Floats, range_m: Floats, fov_deg: tuple[float, float], config: SensorConfig
) -> tuple[tuple[float, float], ...]:
    """Return the directions inside the field of view without any return, from and to in degrees.

    Args:
        azimuth_deg: (n,) azimuths of the points of some sweeps.
        range_m: (n,) their ranges.
        fov_deg: Width of the field of view and the azimuth of its middle.
        config: Settings.
    """
    total = round(360 / config.sector_deg)
    width = 360 / total
    far = range_m > config.near_m
    bins = ((azimuth_deg[far] + 180) / width).astype(np.int64) % total
    count = np.bincount(bins, minlength=total)
    middle = (np.arange(total) + 0.5) * width - 180
    inside = np.abs((middle - fov_deg[1] + 180) % 360 - 180) < fov_deg[0] / 2 - width
    if fov_deg[0] >= 360:
        inside[:] = True
    hidden = inside & (count == 0)
    if not hidden.any() or hidden.all():
        return ()
    start = int(np.flatnonzero(~hidden)[0])
    rolled = np.roll(hidden, -start).astype(np.int8)
    begins, ends = np.flatnonzero(np.diff(rolled) == 1) + 1, np.flatnonzero(np.diff(rolled) == -1) + 1
    ends = np.append(ends, total) if len(ends) < len(begins) else ends
    return tuple(
        (float(((begin + start) % total) * width - 180), float(((end + start - 1) % total + 1) * width - 180))
        for begin, end in zip(begins, ends, strict=True)
    )


def _near(xyz_m: Array, road_z_m: float, config: SensorConfig) -> Array:
    inside = (np.abs(xyz_m[:, 0]) < config.car_reach_m) & (np.abs(xyz_m[:, 1]) < config.car_half_width_m)
    return np.asarray(xyz_m[inside & (xyz_m[:, 2] > road_z_m + _ROAD_M) & xyz_m.any(axis=1)])


def _around(xyz_m: Array, road_z_m: float) -> Array:
    distance = np.hypot(xyz_m[:, 0], xyz_m[:, 1])
    inside = (distance > _SCENE_M[0]) & (distance < _SCENE_M[1]) & (xyz_m[:, 2] > road_z_m + _SCENE_ABOVE_M)
    return np.asarray(xyz_m[inside])


def _cells(xyz_m: Array, edge_m: float) -> Array:
    """Return (n,) the number of the cell of each point; cells are told apart within 2 km."""
    cell = np.floor(np.clip(xyz_m / edge_m, -(2**19), 2**19 - 1)).astype(np.int64) + 2**19
    return np.asarray((cell[:, 0] << 40) | (cell[:, 1] << 20) | cell[:, 2])
