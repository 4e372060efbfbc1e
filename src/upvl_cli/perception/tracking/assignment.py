"""One-to-one assignment at the least total cost."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

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
