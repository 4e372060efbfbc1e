"""One-to-one assignment at the least total cost."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from upvl_cli.types import Array, Floats, Ints


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


def assign_pairs(row: Ints, column: Ints, cost: Floats) -> tuple[Ints, Ints]:
    """Return the assignment of `assign`, from the few pairs that are allowed.

    Rows and columns that no chain of pairs connects do not compete, so that each connected part is assigned alone:
    the memory is that of its pairs, not of all rows times all columns.

    Args:
        row: (k,) row of each allowed pair.
        column: (k,) its column; no pair comes twice.
        cost: (k,) its cost.

    Returns:
        Row numbers in ascending order, and the column of each.
    """
    if not len(row):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    total = int(row.max()) + 1
    size = total + int(column.max()) + 1
    is_alone = (np.bincount(row)[row] == 1) & (np.bincount(column)[column] == 1)
    rows, columns = [row[is_alone]], [column[is_alone]]
    row, column, cost = row[~is_alone], column[~is_alone], cost[~is_alone]
    graph = coo_array((np.ones(len(row)), (row, total + column)), shape=(size, size))
    part = connected_components(graph, directed=False)[1][row]
    order = np.argsort(part, kind="stable")
    for here in np.split(order, np.flatnonzero(np.diff(part[order])) + 1) if len(order) else ():
        row_here, of_row = np.unique(row[here], return_inverse=True)
        column_here, of_column = np.unique(column[here], return_inverse=True)
        dense = np.full((len(row_here), len(column_here)), np.inf)
        dense[of_row, of_column] = cost[here]
        i, j = assign(dense)
        rows.append(row_here[i])
        columns.append(column_here[j])
    found = np.concatenate(rows)
    order = np.argsort(found)
    return found[order], np.concatenate(columns)[order]
