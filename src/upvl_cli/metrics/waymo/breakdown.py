"""How boxes are split into shards that are scored apart: by type, range, size or speed.

Source: waymo-open-dataset 99a4cb3, metrics/breakdown_generator.cc. Its bounds are float32.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.metrics.waymo.inputs import Predictions, Truth, speed_mps
from upvl_cli.metrics.waymo.official import TYPES
from upvl_cli.types import Bools, Ints

ScoredBoxes = Truth | Predictions


@dataclass(frozen=True)
class Breakdown:
    """A way to split boxes.

    Attributes:
        name: Name of the way, as the official configuration has it.
        shards: Name of each shard.
        shard_of: Returns (n,) the shard of each box, -1 for none.
        by_speed: Whether the shard depends on the velocity.
        types_apart: Detection asks the labels alone for their shard: all boxes of a type are matched
            together, and a prediction belongs where its label does (the official VELOCITY).
    """

    name: str
    shards: tuple[str, ...]
    shard_of: Callable[[ScoredBoxes], Ints]
    by_speed: bool = False
    types_apart: bool = False


def _types(prefix: str, *parts: str) -> tuple[str, ...]:
    """Return one name for every type and part, in the official order."""
    return tuple(f"{prefix}_{kind}_{part}".removesuffix("_") for kind in TYPES[1:] for part in parts)


def _shard_of_type(boxes: ScoredBoxes, part: Ints, parts: int) -> Ints:
    """Return shard numbers that count the parts of each type in turn; none for an unknown type."""
    return np.where(boxes.type > 0, parts * (boxes.type - 1) + part, -1)


def _by_type(boxes: ScoredBoxes) -> Ints:
    return np.asarray(boxes.type - 1)


def _by_range(boxes: ScoredBoxes) -> Ints:
    x, y, z = boxes.center_m.T
    with np.errstate(over="ignore"):  # an infinite range is far
        range_m = np.sqrt(x * x + y * y + z * z)
    return _shard_of_type(boxes, np.digitize(range_m, (30.0, 50.0)), 3)


def _by_size(boxes: ScoredBoxes) -> Ints:
    return _shard_of_type(boxes, np.digitize(boxes.size_lwh_m.max(axis=1), (7.0,)), 2)


def _by_velocity(boxes: ScoredBoxes) -> Ints:
    bounds = np.array([0.2, 1.0, 3.0, 10.0], dtype=np.float32)
    return _shard_of_type(boxes, np.digitize(speed_mps(boxes.velocity_mps), bounds), 5)


def _by_sign(boxes: ScoredBoxes) -> Ints:
    return np.where(boxes.type == TYPES.index("TYPE_SIGN"), 1, 0)


def _all(boxes: ScoredBoxes) -> Ints:
    return np.zeros(len(boxes), dtype=np.int64)


OBJECT_TYPE = Breakdown("OBJECT_TYPE", _types("OBJECT_TYPE", ""), _by_type)
RANGE = Breakdown("RANGE", _types("RANGE", "[0, 30)", "[30, 50)", "[50, +inf)"), _by_range)
SIZE = Breakdown("SIZE", _types("SIZE", "small", "large"), _by_size)
VELOCITY = Breakdown(
    "VELOCITY",
    _types("VELOCITY", "STATIONARY", "SLOW", "MEDIUM", "FAST", "VERY_FAST"),
    _by_velocity,
    by_speed=True,
    types_apart=True,
)
ALL_BUT_SIGN = Breakdown("ALL_BUT_SIGN", ("ALL_BUT_SIGN", "SIGN"), _by_sign)
ONE_SHARD = Breakdown("ONE_SHARD", ("ONE_SHARD",), _all)

BREAKDOWNS = {b.name: b for b in (OBJECT_TYPE, RANGE, SIZE, VELOCITY, ALL_BUT_SIGN, ONE_SHARD)}


def moving_objects(*, min_speed_mps: float) -> Breakdown:
    """Return the breakdown that scores moving objects only, by the rule of the official VELOCITY.

    Args:
        min_speed_mps: A label at least this fast is moving; the official shards begin at 0.2 and 1.0.
    """
    bound_mps = float(np.float32(min_speed_mps))

    def shard_of(boxes: ScoredBoxes) -> Ints:
        is_moving: Bools = speed_mps(boxes.velocity_mps) >= bound_mps
        return np.where(is_moving, boxes.type - 1, -1)

    return Breakdown("MOVING", _types("MOVING", ""), shard_of, by_speed=True, types_apart=True)
