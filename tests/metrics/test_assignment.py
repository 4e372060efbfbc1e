"""The matchers on small tables, against brute force."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from plain_scores import scipy_hungarian

from upvl_cli.metrics.waymo.assignment import (
    heaviest_matching,
    match_by_score,
    official_hungarian,
    official_score_first,
    weights_of,
)
from upvl_cli.metrics.waymo.score_order import order_by_score

TABLES = arrays(np.int64, st.tuples(st.integers(1, 4), st.integers(1, 4)), elements=st.integers(0, 4))


def best_matchings(weight: np.ndarray) -> set[frozenset[tuple[int, int]]]:
    """All heaviest matchings without pairs of no weight."""
    n = max(weight.shape)
    square = np.zeros((n, n), dtype=np.int64)
    square[: weight.shape[0], : weight.shape[1]] = weight
    worth = {p: int(square[range(n), p].sum()) for p in permutations(range(n))}
    best = [p for p, w in worth.items() if w == max(worth.values())]
    return {frozenset((r, c) for r, c in enumerate(p) if square[r, c] > 0) for p in best}


@given(TABLES)
def test_heaviest_knows_when_another_matching_weighs_as_much(weight: np.ndarray) -> None:
    pairs = [(int(r), int(c), int(weight[r, c])) for r, c in np.argwhere(weight > 0)]
    chosen, open_pairs = heaviest_matching(pairs)
    best = best_matchings(weight)
    assert frozenset(pairs[i][:2] for i in chosen) in best
    assert bool(open_pairs) == (len(best) > 1)
    undecided = {pair for m in best for pair in m} - frozenset.intersection(*best)
    assert {pairs[i][:2] for i in open_pairs} >= undecided


@given(TABLES)
def test_official_hungarian_is_a_heaviest_matching(weight: np.ndarray) -> None:
    column = official_hungarian(weight)
    assert frozenset((r, int(c)) for r, c in enumerate(column) if c >= 0) in best_matchings(weight)
    mine, theirs = (
        weight[np.flatnonzero(c >= 0), c[c >= 0]].sum() for c in (column, scipy_hungarian(weight))
    )
    assert mine == theirs


@pytest.mark.parametrize(
    ("weight", "column"),
    [
        ([[5], [5]], [0, -1]),  # equal rivals: the first prediction has it
        ([[5, 5]], [0]),  # equal labels: the first one
        ([[5, 5], [5, 0]], [1, 0]),  # unless it is all that the second prediction can have
        ([[9, 5], [5, 0]], [1, 0]),  # more in sum than the best single pair
        ([[9, 3], [5, 0]], [0, -1]),  # heaviest, not most: 9 is more than 3 + 5
        ([[2, 1], [1, 0]], [0, -1]),  # a tie of one pair and two: rows are served in order
    ],
)
def test_ties_fall_as_officially(weight: list[list[int]], column: list[int]) -> None:
    assert official_hungarian(np.array(weight)).tolist() == column


def test_nothing_to_match() -> None:
    assert heaviest_matching([]) == ([], [])
    assert official_hungarian(np.zeros((0, 0), dtype=np.int64)).tolist() == []
    assert official_hungarian(np.zeros((0, 3), dtype=np.int64)).tolist() == []
    assert official_hungarian(np.zeros((2, 0), dtype=np.int64)).tolist() == [-1, -1]
    assert official_score_first(np.zeros((2, 0), dtype=bool), np.zeros((2, 0)), np.ones(2)).tolist() == [
        -1,
        -1,
    ]
    assert match_by_score([], []) == []
    assert order_by_score(np.zeros(0)).tolist() == []


def test_score_first_takes_the_best_free_label_in_turn() -> None:
    weight = np.array([[3, 2], [5, 4]])
    assert official_score_first(weight > 0, weight, np.array([0.9, 0.1])).tolist() == [0, 1]
    assert official_score_first(weight > 0, weight, np.array([0.1, 0.9])).tolist() == [1, 0]
    pairs = [(0, 0, 3), (0, 1, 2), (1, 0, 5), (1, 1, 4)]
    assert match_by_score(pairs, [0.9, 0.9, 0.1, 0.1]) == [0, 3]


def test_weights_are_rounded_as_float32() -> None:
    # 0.7 as float32 is 0.699999988: times a million in float32 it is 700000 exactly.
    assert weights_of(np.array([0.0, 0.7, 1.0, 4e-7, 5e-7])).tolist() == [0, 700000, 1000000, 0, 1]


def test_equal_scores_of_many_come_in_the_order_of_std_sort() -> None:
    """33 scores in tenths; the order is what g++ 12's std::sort with operator> gave (libstdc++, x86-64)."""
    tenths = [
        3,
        3,
        3,
        2,
        3,
        4,
        1,
        3,
        3,
        2,
        3,
        4,
        0,
        3,
        1,
        2,
        1,
        4,
        1,
        4,
        0,
        4,
        1,
        1,
        0,
        1,
        4,
        1,
        1,
        1,
        4,
        0,
        0,
    ]
    order = [
        21,
        26,
        19,
        17,
        5,
        30,
        11,
        1,
        0,
        13,
        10,
        8,
        7,
        4,
        2,
        9,
        15,
        3,
        29,
        28,
        27,
        16,
        25,
        23,
        22,
        18,
        14,
    ]
    assert order_by_score(np.array(tenths, dtype=np.float32) / 10).tolist() == [*order, 6, 24, 20, 12, 31, 32]


@given(st.lists(st.integers(0, 9), max_size=200))
def test_score_order_descends(tenths: list[int]) -> None:
    order = order_by_score(np.array(tenths) / 10)
    assert sorted(order.tolist()) == list(range(len(tenths)))
    assert (np.diff(np.array(tenths, dtype=np.int64)[order]) <= 0).all()
    if len(tenths) <= 16:  # short ranges are only insertion-sorted: stable
        np.testing.assert_array_equal(order, np.argsort(-np.array(tenths, dtype=np.int64), kind="stable"))
