"""Labels and predictions of any number of drives as parallel arrays, in the terms of the official tools."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.official import MAX_POINTS_LEVEL_2, TYPES
from upvl_cli.types import Array, Boxes, Floats, Ints, array


@dataclass(frozen=True)
class Truth(Boxes):
    """Labels: human boxes, each in the ego axes of its frame.

    Attributes:
        sequence: (n,) name of the segment.
        frame: (n,) number or time of the frame inside its segment.
        type: (n,) VEHICLE 1, PEDESTRIAN 2, SIGN 3, CYCLIST 4, anything else 0.
        level: (n,) difficulty 1 or 2; 0 counts at every level.
        velocity_mps: (n, 2) over the ground; NaN where unknown, which counts as standing.
        object_id: (n,) which object; used by tracking only.
    """

    sequence: Array = array("str")
    frame: Array = array("int64")
    type: Array = array("int64")
    level: Array = array("int64")
    velocity_mps: Array = array("float64", 2)
    object_id: Array = array("str")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_boxes(self, "label")
        _check(self, np.isin(self.level, (0, 1, 2)), "label", "an unknown level, expected 0, 1 or 2")


@dataclass(frozen=True)
class Predictions(Boxes):
    """Boxes to score, each in the ego axes of its frame.

    Attributes:
        sequence: (m,) name of the segment.
        frame: (m,) number or time of the frame inside its segment.
        type: (m,) VEHICLE 1, PEDESTRIAN 2, SIGN 3, CYCLIST 4, anything else 0.
        score: (m,) confidence; a box below the first cut-off is never used.
        velocity_mps: (m, 2) over the ground; NaN where unset.
        object_id: (m,) which track; used by tracking only.
        unlabelled: (m,) whether it overlaps a zone without labels, where it is no false positive.
    """

    sequence: Array = array("str")
    frame: Array = array("int64")
    type: Array = array("int64")
    score: Array = array("float32")
    velocity_mps: Array = array("float64", 2)
    object_id: Array = array("str")
    unlabelled: Array = array("bool")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_boxes(self, "prediction")
        _check(self, ~np.isnan(self.score), "prediction", "a score that is not a number; drop it or mend it")


Scored = TypeVar("Scored", Truth, Predictions)


def map_types(boxes: Scored, types: Mapping[int, int]) -> Scored:
    """Return the boxes under other types: {4: 2} makes riders walkers, {2: 1, 3: 1, 4: 1} ignores the type.

    Args:
        boxes: Labels or predictions; both sides need the same mapping.
        types: New type by old type; a type that is not a key stays.
    """
    table = np.arange(len(TYPES))
    table[list(types)] = list(types.values())
    return replace(boxes, type=table[boxes.type])


def resolve_level(level: Ints, points: Ints) -> Ints:
    """Return (n,) the level that the detection tool uses where a label has none: 2 up to 5 points, else 1.

    The tool also drops labels without a point (`truth[points > 0]`); for tracking it does neither. Source: Sun et
    al., Scalability in Perception for Autonomous Driving: Waymo Open Dataset, CVPR 2020, Section 3.4.

    Args:
        level: (n,) level as labelled, 0 for none; a labelled one stays.
        points: (n,) LiDAR points inside each box, -1 where nobody counted: those are level 1.
    """
    few = (np.asarray(points) >= 0) & (np.asarray(points) <= MAX_POINTS_LEVEL_2)
    return np.where(np.asarray(level) > 0, level, np.where(few, 2, 1)).astype(np.int64)


def speed_mps(velocity_mps: Floats) -> Floats:
    """Return (n,) speeds over the ground, 0 where unknown.

    Args:
        velocity_mps: (n, 2) velocities, NaN where unknown.
    """
    known = np.where(np.isnan(velocity_mps).any(axis=1, keepdims=True), 0.0, velocity_mps)
    return np.asarray(np.sqrt(known[:, 0] * known[:, 0] + known[:, 1] * known[:, 1]))


def _check_boxes(boxes: Truth | Predictions, what: str) -> None:
    finite = np.isfinite(boxes.center_m).all(axis=1) & np.isfinite(boxes.size_lwh_m).all(axis=1)
    finite &= np.isfinite(boxes.heading_rad)
    _check(boxes, finite, what, "a box that is not finite; drop it or mend its source")
    known = np.isin(boxes.type, range(len(TYPES)))
    _check(boxes, known, what, f"an unknown type, expected 0 to {len(TYPES) - 1}")


def _check(boxes: Truth | Predictions, passes: Array, what: str, problem: str) -> None:
    if passes.all():
        return
    row = int(np.flatnonzero(~passes)[0])
    raise BadInput(f"{what} {row} (segment {boxes.sequence[row]}, frame {boxes.frame[row]}) has {problem}")
