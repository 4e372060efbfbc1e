"""Which sides of an object were shown to the sensor, and where its hidden part lies."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.amodal.config import SizePriorConfig
from upvl_cli.types import Array, Bools, Floats, Ints


def shown_sides(size_m: Floats, sensor_xy_m: Array, num_points: Ints, config: SizePriorConfig) -> Bools:
    """Return (4,) whether front, rear, left and right were turned to the sensor in a frame that counts.

    Args:
        size_m: (2,) length and width that were seen, about the origin.
        sensor_xy_m: (T, 2) sensor in the axes of the object.
        num_points: (T,) points in each frame; those with less than half of the most do not count.
        config: Angle from which a side shows.
    """
    beyond_m = np.column_stack([sensor_xy_m - size_m / 2, -sensor_xy_m - size_m / 2])[:, [0, 2, 1, 3]]
    sine = beyond_m / np.maximum(np.linalg.norm(sensor_xy_m, axis=1, keepdims=True), 1e-9)
    counts = 2 * num_points >= num_points.max(initial=0)
    return np.asarray((sine[counts] >= np.sin(np.deg2rad(config.min_shown_deg))).any(axis=0))


def complete_center(low: Array, high: Array, sensor_xy_m: Array, size_m: Array, *, is_vehicle: bool) -> Array:
    """Return (T, 2) center of a box of that size whose hidden part lies behind what faces the sensor.

    A vehicle shows a corner: the hidden part lies away from the sensor, along and across; where the sensor is beside
    what was seen, between its two ends, either end may be the hidden one, and the part is shared by both. A person
    shows one side, wholly: the rest is behind that, along the line of sight.

    Args:
        low: (T, 2) lowest coordinates of what was seen, along and across the heading.
        high: (T, 2) highest coordinates.
        sensor_xy_m: (T, 2) sensor in the same axes.
        size_m: (2,) length and width of the box.
        is_vehicle: Whether it has flat sides.
    """
    middle, half_m = (low + high) / 2, np.maximum((high - low) / 2, 1e-9)
    sight = middle - sensor_xy_m
    if is_vehicle:
        away = np.clip(sight / np.maximum(half_m, size_m / 2), -1, 1)
    else:
        away = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    return np.asarray(middle + away * (size_m - (high - low)) / 2)


def anchor(registered: Array, faced: Array, time_s: Floats, window_s: float, *, fallback: Array) -> Array:
    """Return (T, 2) centers of boxes: as registered, less the median by which the faces turned to the sensor are off.

    Registration follows the shape of what is seen, and drifts where another part of it comes into view. A face that is
    turned to the sensor is where the points end, whatever else is hidden; alone it strays from frame to frame.

    Args:
        registered: (T, 2) centers by registration; NaN in frames that are not registered.
        faced: (T, 2) centers by the faces turned to the sensor, along and across; NaN where no face is.
        time_s: (T,) ascending times.
        window_s: Length of the window, about each frame, of which the median is taken.
        fallback: (T, 2) centers for frames that are not registered.
    """
    off = faced - registered
    is_registered = np.isfinite(registered).all(axis=1, keepdims=True)
    shift = np.zeros_like(registered)
    for axis in range(2):
        known = np.flatnonzero(np.isfinite(off[:, axis]))
        first = np.searchsorted(time_s[known], time_s - window_s / 2, side="left")
        last = np.searchsorted(time_s[known], time_s + window_s / 2, side="right")
        windows, row = np.unique(np.stack([first, last]), axis=1, return_inverse=True)
        medians = [np.median(off[known[begin:end], axis]) if end > begin else 0.0 for begin, end in windows.T]
        shift[:, axis] = np.array(medians)[row.reshape(-1)]
    return np.where(is_registered, registered + shift, fallback)
