"""Which way is up in a sweep, by the plane of the road, when no axis is believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.drive_check.motion_config import RoadConfig
from upvl_cli.perception.voxels import row_keys
from upvl_cli.types import Array, Bools, Floats

AXES = ("x", "y", "z", "-x", "-y", "-z")
DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True)
class RoadPlane:
    """The road around the car, in the axes of the points.

    Attributes:
        normal: (3,) unit vector that points up.
        height_m: Height of the origin above the road, in units of the points.
        axis: The axis of the points that is nearest to up, such as "z" or "-y".
        support: (6,) cells of 1 m or so that each of `AXES` as up would explain as road.
    """

    normal: Floats
    height_m: float
    axis: str
    support: Floats

    @property
    def is_clear(self) -> bool:
        """Whether no other axis could be up as well: up has twice the support of any other."""
        best, second = np.sort(self.support)[::-1][:2]
        return bool(best > 2 * max(second, 0.0))

    @property
    def tilt_rad(self) -> float:
        """Angle between up and the nearest axis."""
        return float(np.arccos(np.clip(self.normal @ DIRECTIONS[AXES.index(self.axis)], -1, 1)))


def find_road(xyz: Floats, config: RoadConfig) -> RoadPlane | None:
    """Return the plane of the road; None where no axis has one.

    For each of the six directions that the axes can have, the lowest point of each cell around the car is a candidate
    for the road. The road is the plane with most of them that has least below it.

    Args:
        xyz: (n, 3) points in metres, roughly; any axes.
        config: Cells and tolerances.
    """
    xyz = xyz[:: max(len(xyz) // config.max_points, 1)]
    planes = [_fit(xyz, direction, config) for direction in DIRECTIONS]
    support = np.array([plane[2] for plane in planes])
    best = int(np.argmax(support))
    if support[best] < config.min_cells:
        return None
    normal, height_m, _ = planes[best]
    nearest = int(np.argmax(DIRECTIONS @ normal))
    return RoadPlane(normal, height_m, AXES[nearest], support)


def _fit(xyz: Floats, up: Floats, config: RoadConfig) -> tuple[Floats, float, float]:
    """Return normal, height of the origin and support of the road, were that direction up."""
    first = np.roll(np.abs(up), 1)
    basis = np.stack([first, np.cross(up, first), up])  # rows: two level directions and up
    level = xyz @ basis.T
    level = level[np.hypot(level[:, 0], level[:, 1]) < config.radius_m]
    if len(level) < config.min_cells:
        return up, 0.0, 0.0
    lowest = _low_points(level, config)
    plane = _robust_plane(lowest, config)
    if plane is None:
        return up, 0.0, 0.0
    slope_x, slope_y, height = plane
    height_m = _residual(level, plane)
    above, below = ((sign * height_m > config.clear_height_m).sum() for sign in (1, -1))
    cells = (np.abs(_residual(lowest, plane)) < config.tolerance_m).sum()
    support = float(cells * above / max(above + below, 1))
    normal = np.array([-slope_x, -slope_y, 1.0]) @ basis
    length = float(np.linalg.norm(normal))
    return normal / length, -float(height) / length, support


def _low_points(level: Floats, config: RoadConfig) -> Floats:
    """Return a low point of each cell, not the lowest where there are several: reflections lie below the road."""
    keys = row_keys(np.floor(level[:, :2] / config.cell_m).astype(np.int64))
    order = np.lexsort((level[:, 2], keys))
    begins = np.flatnonzero(np.append(True, np.diff(keys[order]) != 0))
    count = np.diff(np.append(begins, len(order)))
    return np.asarray(level[order[begins + np.minimum(1, count - 1)]])


def _residual(level: Floats, plane: Floats) -> Floats:
    return np.asarray(level[:, 2] - level[:, 0] * plane[0] - level[:, 1] * plane[1] - plane[2])


def _robust_plane(low: Floats, config: RoadConfig) -> Floats | None:
    """Fit a plane to the densest layer of low points, then to what lies near it, in rounds."""
    if len(low) < config.min_cells:
        return None
    heights = np.sort(low[:, 2])
    width = max(len(heights) // 3, 2)  # the third of the cells that lie closest together in height
    start = int(np.argmin(heights[width - 1 :] - heights[: len(heights) - width + 1]))
    plane = np.array([0.0, 0.0, float(heights[start : start + width].mean())])
    for tolerance_m in (1.0, 0.5, config.tolerance_m, config.tolerance_m):
        near: Bools = np.abs(_residual(low, plane)) < tolerance_m
        if near.sum() < config.min_cells:
            return None
        design = np.column_stack([low[near, :2], np.ones(near.sum())])
        plane = np.linalg.lstsq(design, low[near, 2], rcond=None)[0]
    if np.hypot(plane[0], plane[1]) > config.max_slope:
        return None
    return plane


def level_from_points(road: RoadPlane | None) -> Array:
    """Return the (3, 3) rotation from the axes of the points to level axes, whose z is up.

    Where z is up already, x and y stay what they are but for the tilt.
    """
    if road is None:
        return np.eye(3)
    up = DIRECTIONS[AXES.index(road.axis)]
    first = np.array([1.0, 0.0, 0.0]) if road.axis in ("z", "-z") else np.roll(np.abs(up), 1)
    basis = np.stack([first, np.cross(up, first), up])
    normal = basis @ road.normal  # in the axes of the basis: nearly z
    first = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    first /= np.linalg.norm(first)
    return np.asarray(np.stack([first, np.cross(normal, first), normal]) @ basis)
