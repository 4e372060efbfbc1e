"""The area under the official curve on numbers that can be checked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upvl_cli.metrics.waymo.average_precision import average_precision

UNITS = st.floats(0, 1, width=32)


@pytest.mark.parametrize(
    ("precision", "recall", "area", "why"),
    [
        ([], [], 0.0, "no cut-off"),
        ([1.0], [0.0], 0.0, "nothing found"),
        ([1.0], [1.0], 1.0, "perfect"),
        ([0.5], [0.5], 0.25, "one point: precision times recall"),
        ([0.5, 0.5, 1.0], [0.5, 0.5, 0.0], 0.25, "the point at recall 0 never counts"),
        ([0.5, 1.0], [0.04, 0.02], 0.02 * 1.0 + 0.02 * 0.75, "no gap: trapezoids"),
        (
            [0.5, 1.0],
            [0.2, 0.1],
            0.05 * 0.5 + 0.05 * 0.75 + 0.1 * 1.0,
            "a gap keeps the far side's precision",
        ),
        ([1.0, 0.5], [0.2, 0.1], 0.2 * 1.0, "precision never falls towards low recall"),
        ([0.2, 0.8], [0.5, 0.5], 0.4, "the best precision of one recall"),
    ],
)
def test_by_hand(precision: list[float], recall: list[float], area: float, why: str) -> None:
    assert average_precision(np.array(precision), np.array(recall)) == pytest.approx(area, abs=1e-6), why


@given(st.lists(st.tuples(UNITS, UNITS), max_size=30))
def test_stays_between_0_and_the_best_point(points: list[tuple[float, float]]) -> None:
    precision, recall = np.array(points, dtype=np.float32).reshape(-1, 2).T
    area = average_precision(precision, recall)
    top = max((p for p, r in points if r > 0), default=0)
    assert 0 <= area <= top * recall.max(initial=0) + 1e-5
