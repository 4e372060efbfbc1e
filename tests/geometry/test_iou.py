"""Rotated IoU against an exact, slow polygon clip."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from exact_clip import shared_area
from hypothesis import given, settings
from hypothesis import strategies as st
from on_rows import iou_3d, iou_3d_pairs, iou_bev, iou_bev_pairs

from upvl_cli.errors import BadInput

PI = math.pi
UNIT = [0, 0, 0, 1, 1, 1, 0]


def slow_bev(a: Sequence[float], b: Sequence[float], number: Any = Fraction) -> float:
    shared = shared_area(a, b, number)
    union = a[3] * a[4] + b[3] * b[4] - shared
    return shared / union if union > 1e-6 else 0.0


def slow_3d(a: Sequence[float], b: Sequence[float], number: Any = Fraction) -> float:
    sizes = [*a[3:6], *b[3:6]]
    if min(sizes) <= 1e-2 or max(sizes) >= 1e6:
        return 0.0
    dz = min(a[2] + a[5] / 2, b[2] + b[5] / 2) - max(a[2] - a[5] / 2, b[2] - b[5] / 2)
    shared = shared_area(a, b, number) * max(dz, 0)
    union = math.prod(a[3:6]) + math.prod(b[3:6]) - shared
    return shared / union if union > 1e-6 else 0.0


def random_boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    centre, size = rng.normal(0, 1.5, (n, 3)), np.exp(rng.normal(0.5, 0.9, (n, 3)))
    return np.column_stack([centre, size, rng.uniform(-7, 7, n)])


def test_many_random_pairs_equal_the_slow_clip() -> None:
    rng = np.random.default_rng(3)
    a, b = random_boxes(rng, 100_000), random_boxes(rng, 100_000)
    bev, volume = iou_bev_pairs(a, b), iou_3d_pairs(a, b)
    assert (bev > 0).mean() > 0.4
    rows_a, rows_b = a.tolist(), b.tolist()
    shared = np.array([shared_area(p, q, float) for p, q in zip(rows_a, rows_b, strict=True)])
    np.testing.assert_allclose(bev, shared / (a[:, 3] * a[:, 4] + b[:, 3] * b[:, 4] - shared), atol=1e-9)
    tops = np.minimum(a[:, 2] + a[:, 5] / 2, b[:, 2] + b[:, 5] / 2)
    shared *= np.maximum(tops - np.maximum(a[:, 2] - a[:, 5] / 2, b[:, 2] - b[:, 5] / 2), 0)
    union = a[:, 3:6].prod(axis=1) + b[:, 3:6].prod(axis=1) - shared
    np.testing.assert_allclose(volume, shared / union, atol=1e-9)


CASES = [
    ("identical", UNIT, UNIT, 1.0),
    ("identical, turned", [3, 4, 0, 4, 2, 1, 0.3], [3, 4, 0, 4, 2, 1, 0.3], 1.0),
    ("the same the other way round", [3, 4, 0, 4, 2, 1, 0.3], [3, 4, 0, 4, 2, 1, 0.3 - PI], 1.0),
    ("a square by a quarter turn", UNIT, [0, 0, 0, 1, 1, 1, PI / 2], 1.0),
    ("half shifted", UNIT, [0.5, 0, 0, 1, 1, 1, 0], 1 / 3),
    ("contained", [0, 0, 0, 4, 2, 1, 0.7], [0, 0, 0, 2, 1, 1, 0.7], 1 / 4),
    ("contained, edges shared", [0, 0, 0, 4, 2, 1, 0], [1, 0, 0, 2, 2, 1, 0], 1 / 2),
    ("a cross", [0, 0, 0, 4, 1, 1, 0.2], [0, 0, 0, 4, 1, 1, 0.2 + PI / 2], 1 / 7),
    ("an eighth turn", UNIT, [0, 0, 0, 1, 1, 1, PI / 4], 1 / math.sqrt(2)),
    ("touching edges", UNIT, [1, 0, 0, 1, 1, 1, 0], 0.0),
    ("touching corners", UNIT, [1, 1, 0, 1, 1, 1, 0], 0.0),
    ("corner on an edge", UNIT, [0.5 + math.sqrt(0.5), 0, 0, 1, 1, 1, PI / 4], 0.0),
    ("far", UNIT, [50, 0, 0, 1, 1, 1, 0.1], 0.0),
    ("inside each other's circle, yet apart", [0, 0, 0, 10, 1, 1, 0], [0, 3, 0, 10, 1, 1, 0], 0.0),
    ("far from the origin", [1e5, -1e5, 0, 4, 2, 1, 0], [1e5 + 2, -1e5, 0, 4, 2, 1, 0], 1 / 3),
    ("headings of many turns", [0, 0, 0, 4, 2, 1, 0.3], [0, 0, 0, 4, 2, 1, 0.3 + 200 * PI], 1.0),
    ("huge", [0, 0, 0, 9e5, 9e5, 9e5, 0.1], [0, 0, 0, 9e5, 9e5, 9e5, 0.1], 1.0),
    ("too large", [0, 0, 0, 1e6, 1, 1, 0], [0, 0, 0, 1e6, 1, 1, 0], 0.0),
    ("no width", [0, 0, 0, 4, 0, 1, 0], [0, 0, 0, 4, 0, 1, 0], 0.0),
    ("no size", [0, 0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 0], 0.0),
    ("inside out", [0, 0, 0, -1, -1, -1, 0], [0, 0, 0, -1, -1, -1, 0], 0.0),
]


@pytest.mark.parametrize(("a", "b", "expected"), [case[1:] for case in CASES], ids=[c[0] for c in CASES])
def test_cases_a_person_can_check(a: list[float], b: list[float], expected: float) -> None:
    for measure in (iou_bev, iou_3d):
        assert measure([a], [b])[0, 0] == pytest.approx(expected, abs=1e-9)
        assert measure([b], [a])[0, 0] == pytest.approx(expected, abs=1e-9)


HEIGHTS = [
    ("half as high", 0.0, 0.5, 0.5),
    ("raised by half", 0.5, 1.0, 1 / 3),
    ("standing on top", 1.0, 1.0, 0.0),
    ("above", 5.0, 1.0, 0.0),
    ("one centimetre", 0.0, 0.01, 0.0),
    ("just more than one centimetre", 0.0, 0.011, 0.011),
]


@pytest.mark.parametrize(("z", "height", "expected"), [c[1:] for c in HEIGHTS], ids=[c[0] for c in HEIGHTS])
def test_height(z: float, height: float, expected: float) -> None:
    assert iou_3d([UNIT], [[0, 0, z, 1, 1, height, 0]])[0, 0] == pytest.approx(expected, abs=1e-12)
    assert iou_bev([UNIT], [[0, 0, z, 1, 1, height, 0]])[0, 0] == 1.0


def test_nearly_parallel_boxes_with_shared_edges() -> None:
    rng = np.random.default_rng(5)
    a = np.round(random_boxes(rng, 600) * 4) / 4
    a[:, 3:6] = np.abs(a[:, 3:6]) + 0.25
    b = a.copy()
    b[::3, 0] += np.cos(a[::3, 6]) * a[::3, 3] / 2
    b[::3, 1] += np.sin(a[::3, 6]) * a[::3, 3] / 2
    b[1::3, 4] /= 2
    b[:, 6] += (
        rng.choice([-1, 1], 600) * 10.0 ** rng.integers(-18, -2, 600) + rng.integers(0, 4, 600) * PI / 2
    )
    a[::2, :2] += 1e5
    b[::2, :2] += 1e5
    expected = [slow_bev(p, q) for p, q in zip(a.tolist(), b.tolist(), strict=True)]
    np.testing.assert_allclose(iou_bev_pairs(a, b), expected, atol=1e-9)


metres = st.one_of(st.floats(-3, 3), st.sampled_from([0.0, 1.0, -1.0, 0.5, 1e5]))
sizes = st.one_of(st.floats(0.02, 6), st.sampled_from([0.5, 1.0, 2.0, 1e-9, 0.0, 1e4]))
headings = st.one_of(st.floats(-4, 4), st.sampled_from([0.0, PI / 2, PI, -PI / 2, PI / 4, 1e-12, 1e-300]))
boxes = st.tuples(metres, metres, metres, sizes, sizes, sizes, headings)


@given(boxes, boxes)
@settings(max_examples=400)
def test_any_pair_equals_the_exact_clip(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    assert iou_bev([a], [b])[0, 0] == pytest.approx(slow_bev(a, b), abs=1e-6)
    assert iou_3d([a], [b])[0, 0] == pytest.approx(slow_3d(a, b), abs=1e-6)


anything = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(st.tuples(*[anything] * 7), max_size=4))
def test_any_finite_boxes_give_zero_to_one(rows: list[tuple[float, ...]]) -> None:
    for measure in (iou_bev, iou_3d):
        values = measure(np.reshape(rows, (-1, 7)), np.reshape(rows, (-1, 7)))
        assert ((values >= 0) & (values <= 1)).all()


def test_matrices_equal_pairs_also_across_blocks() -> None:
    rng = np.random.default_rng(6)
    a, b = random_boxes(rng, 7), random_boxes(rng, 9000)
    b[:, 0] *= 20
    row, column = np.indices((7, 9000)).reshape(2, -1)
    for matrix, pairs in ((iou_bev, iou_bev_pairs), (iou_3d, iou_3d_pairs)):
        np.testing.assert_array_equal(matrix(a, b).ravel(), pairs(a[row], b[column]))
        np.testing.assert_array_equal(matrix(b, a).T.ravel(), pairs(b[column], a[row]))
    wide = np.tile(b, (5, 1))
    np.testing.assert_array_equal(iou_bev(a, wide), np.tile(iou_bev(a, b), 5))


@pytest.mark.parametrize("measure", [iou_bev, iou_3d, iou_bev_pairs, iou_3d_pairs])
def test_empty(measure: Any) -> None:
    assert measure(np.zeros((0, 7)), []).size == 0
    if measure in (iou_bev, iou_3d):
        assert measure([UNIT], []).shape == (1, 0)
        assert measure([], [UNIT]).shape == (0, 1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("measure", [iou_bev, iou_3d, iou_bev_pairs, iou_3d_pairs])
def test_a_box_that_is_not_finite_is_named(measure: Any, bad: float) -> None:
    rows = np.array([UNIT, UNIT], dtype=float)
    rows[1, 4] = bad
    with pytest.raises(BadInput, match=r"^box 1 is not finite.*$"):
        measure(np.array([UNIT, UNIT]), rows)


def test_pairs_of_different_number_are_refused() -> None:
    with pytest.raises(BadInput, match="2 boxes against 1"):
        iou_bev_pairs([UNIT, UNIT], [UNIT])
