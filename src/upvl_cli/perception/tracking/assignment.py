"""One-to-one assignment at the least total cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from upvl_cli.types import Array, Ints


def assign(cost: Array) -> tuple[Ints, Ints]:
    """Return the assignment of rows to columns with the most pairs, and of those the one of the least total cost.

    The Hungarian algorithm (Kuhn, 1955), with forbidden pairs.

    Args:
        cost: (n, m) cost of each pair, not negative; infinite where the pair is not allowed.

    Returns:
        Row numbers in ascending order, and the column of each.
    """
    allowed = np.isfinite(cost)
    if not allowed.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    # One forbidden pair costs more than all allowed ones together.
    forbidden = 1.0 + cost[allowed].max() * (min(cost.shape) + 1)
    rows, columns = linear_sum_assignment(np.where(allowed, cost, forbidden))
    is_pair = allowed[rows, columns]
    return rows[is_pair], columns[is_pair]


def assign_pairs(pairs: Sequence[tuple[int, int, float]]) -> dict[int, int]:
    """Return the column of each row in the assignment of `assign`, from the few pairs that are allowed.

    Rows and columns that no chain of pairs connects do not compete, so that each connected part is assigned alone:
    the memory is that of its pairs, not of all rows times all columns.

    Args:
        pairs: Row, column and cost of each allowed pair.
    """
    if not pairs:
        return {}
    row, column = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    cost = np.array([pair[2] for pair in pairs])
    total = int(row.max()) + 1
    size = total + int(column.max()) + 1
    graph = coo_array((np.ones(len(pairs)), (row, total + column)), shape=(size, size))
    part = connected_components(graph, directed=False)[1][row]
    order = np.argsort(part, kind="stable")
    found: dict[int, int] = {}
    for here in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        rows, of_row = np.unique(row[here], return_inverse=True)
        columns, of_column = np.unique(column[here], return_inverse=True)
        dense = np.full((len(rows), len(columns)), np.inf)
        dense[of_row, of_column] = cost[here]
        found.update((int(rows[i]), int(columns[j])) for i, j in zip(*assign(dense), strict=True))
    return found
