"""Completion of the size and the center of an object of which a side is hidden."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.amodal.config import SizeCompletionConfig
from upvl_cli.types import Array


def person_size(height_m: float, config: SizeCompletionConfig) -> Array:
    """Return (2,) length and width that a person of that height has at least; zeros for other heights.

    Of a person one side is seen; a child is slimmer in proportion.
    """
    if not config.min_person_height_m <= height_m <= config.max_person_height_m:
        return np.zeros(2)
    adult_m = np.array([config.person_length_m, config.person_width_m])
    return adult_m * min(height_m / config.person_height_m, 1.0)


def complete_size(size_m: Array, min_size_m: Array, config: SizeCompletionConfig) -> Array:
    """Return (2,) length and width, not below those of a person or, where it is that long or wide, of a car.

    Args:
        size_m: (2,) length and width that were seen.
        min_size_m: (2,) length and width of `person_size`.
        config: Settings.
    """
    length_m, width_m = np.maximum(size_m, min_size_m)
    if width_m > config.min_wheeled_width_m or length_m > config.min_car_length_m:
        length_m, width_m = max(length_m, config.car_length_m), max(width_m, config.car_width_m)
        length_m = max(length_m, config.min_aspect * width_m)
    return np.array([length_m, width_m])


def complete_center(
    low: Array, high: Array, sensor_xy_m: Array, size_m: Array, config: SizeCompletionConfig
) -> Array:
    """Return (T, 2) center of a box of that size whose hidden part lies behind the edge that faces the sensor.

    A vehicle shows a corner, so that this holds along and across. A small object shows one side, wholly: its
    rest is behind that, along the line of sight.

    Args:
        low: (T, 2) lowest coordinates of what was seen, along and across the heading.
        high: (T, 2) highest coordinates.
        sensor_xy_m: (T, 2) sensor in the same axes.
        size_m: (2,) length and width of the box.
        config: Settings.
    """
    middle = (low + high) / 2
    sight = middle - sensor_xy_m
    away = np.sign(sight)
    if size_m.max() <= config.min_wheeled_width_m:
        away = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    return np.asarray(middle + away * (size_m - (high - low)) / 2)
