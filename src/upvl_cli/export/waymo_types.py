"""Waymo's types of objects, and the boxes whose class they cannot say."""

from __future__ import annotations

from collections import Counter

import numpy as np

from upvl_cli.datasets.shared.class_types import type_of_class
from upvl_cli.datasets.waymo.names import TYPES
from upvl_cli.export.drive import ExportBoxes, Losses
from upvl_cli.types import Bools, Ints

CLASSES = {
    "vehicle": "Vehicle",
    "pedestrian": "Pedestrian",
    "cyclist": "Cyclist",
    "sign": "Sign",
    "unknown": "Unknown",
}
_NUMBERS = {name: number for number, name in TYPES.items()}


def type_numbers(boxes: ExportBoxes) -> Ints:
    """Return (n,) Waymo's number of each box: 0 where its class is none of Waymo's, nor a kind of one."""
    names = [str(name) for name in boxes.class_name]
    known = {name: _NUMBERS.get(name, type_of_class(name)) for name in set(names)}
    return np.array([known[name] for name in names], dtype=np.int64)


def is_named_otherwise(boxes: ExportBoxes, types: Ints) -> Bools:
    """Return (n,) whether the type of a box does not say its class."""
    return np.array(
        [TYPES[int(number)] != name for number, name in zip(types, boxes.class_name, strict=True)], dtype=bool
    )


def count_types(boxes: ExportBoxes, types: Ints, where: str, losses: Losses) -> None:
    """Count the boxes whose class Waymo has not, by class."""
    others = is_named_otherwise(boxes, types)
    found = Counter(zip(boxes.class_name[others].tolist(), types[others].tolist(), strict=True))
    for (name, number), count in found.items():
        losses[
            f"boxes of class {name!r}, which Waymo has not: of type {TYPES[number]}, the class in {where}"
        ] += count


def class_names(types: Ints) -> list[str]:
    """Return the name of each type; Unknown for a number that Waymo has not."""
    return [TYPES.get(int(number), TYPES[0]) for number in types]
