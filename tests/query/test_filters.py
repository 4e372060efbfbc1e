"""Each bound of a filter: what it compares, and that it belongs to what passes."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from upvl_cli.query.filters import Filters
from upvl_cli.query.index import Objects

STEP = 0.25  # exact in binary, so that a bound can be met exactly


def objects(**columns: object) -> Objects:
    """Three boxes that are alike but for these columns."""
    values = {spec.name: np.zeros((3, *spec.metadata["shape"])) for spec in fields(Objects)}
    return Objects(**{**values, **columns})


SPEED = objects(velocity_mps=np.array([[3, 4 - STEP, 9], [3, 4, 0], [3, 4 + STEP, 0]]))
RANGE = objects(center_m=np.array([[3, -4 + STEP, 90], [3, -4, 0], [3, -4 - STEP, 0]]))
TIME = objects(time_s=np.array([5 - STEP, 5, 5 + STEP]))
CONFIDENCE = objects(confidence=np.array([0.25, 0.5, 0.75]))


@pytest.mark.parametrize(
    ("filters", "boxes", "expected"),
    [
        (Filters(), SPEED, [True, True, True]),
        (Filters(min_speed_mps=5), SPEED, [False, True, True]),  # horizontal: the first climbs at 9 m/s
        (Filters(max_speed_mps=5), SPEED, [True, True, False]),
        (Filters(moving=True), SPEED, [False, True, True]),  # from moving_mps on
        (Filters(moving=False), SPEED, [True, False, False]),
        (Filters(max_range_m=5), RANGE, [True, True, False]),  # horizontal: the first is 90 m above
        (Filters(from_s=5), TIME, [False, True, True]),
        (Filters(to_s=5), TIME, [True, True, False]),
        (Filters(from_s=5, to_s=5), TIME, [False, True, False]),
        (Filters(min_confidence=0.5), CONFIDENCE, [False, True, True]),
        (Filters(min_speed_mps=0.0, min_confidence=0.0), TIME, [True, True, True]),
        (Filters(max_speed_mps=0.0), SPEED, [False, False, False]),  # a bound of 0 is a bound
        (Filters(from_s=5, min_confidence=0.5), TIME, [False, False, False]),  # all have to hold
    ],
)
def test_each_bound(filters: Filters, boxes: Objects, expected: list[bool]) -> None:
    assert filters.mask(boxes, moving_mps=5).tolist() == expected


def test_no_named_drive_takes_all() -> None:
    assert Filters().includes("a")
    assert Filters(segments=("a", "b")).includes("b")
    assert not Filters(segments=("a",)).includes("ab")
