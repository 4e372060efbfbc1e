"""An assignment has the most pairs that are allowed, and of those the least cost: against all permutations."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from upvl_cli.perception.tracking.assignment import assign, assign_pairs


def brute_force(cost: np.ndarray) -> tuple[int, float]:
    """The number of pairs and the cost of the best assignment, by trying all."""
    if cost.shape[0] > cost.shape[1]:
        return brute_force(cost.T)
    found = []
    for columns in permutations(range(cost.shape[1]), cost.shape[0]):
        costs = cost[np.arange(len(columns)), list(columns)]
        allowed = costs[np.isfinite(costs)]
        found.append((-len(allowed), float(allowed.sum())))
    pairs, total = min(found)
    return -pairs, total


@pytest.mark.parametrize("seed", range(20))
def test_the_assignment_is_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0, 10, rng.integers(1, 6, 2))
    cost[rng.uniform(size=cost.shape) < 0.4] = np.inf
    rows, columns = assign(cost)
    pairs, total = brute_force(cost)
    assert len(rows) == len(set(columns.tolist())) == pairs
    assert cost[rows, columns].sum() == pytest.approx(total)
    assert (np.diff(rows) > 0).all()


def test_two_dear_pairs_are_better_than_one_cheap_one() -> None:
    rows, columns = assign(np.array([[0.0, 9.0], [9.0, np.inf]]))
    assert (rows.tolist(), columns.tolist()) == ([0, 1], [1, 0])


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (2, 0), (2, 3)])
def test_nothing_allowed_gives_no_pair(shape: tuple[int, int]) -> None:
    rows, columns = assign(np.full(shape, np.inf))
    assert len(rows) == len(columns) == 0


def test_pairs_that_do_not_compete_are_assigned_as_all_at_once() -> None:
    """The plain way is one matrix of all rows and columns."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        cost = np.where(rng.random((12, 9)) < 0.2, rng.random((12, 9)), np.inf)
        row, column = np.nonzero(np.isfinite(cost))
        for found, expected in zip(assign_pairs(row, column, cost[row, column]), assign(cost), strict=True):
            np.testing.assert_array_equal(found, expected)
    none = np.zeros(0, np.int64)
    assert [len(part) for part in assign_pairs(none, none, np.zeros(0))] == [0, 0]
