"""Thin a sweep to a number of points: evenly in space, so that what is far away keeps its few points."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array, Ints

_FIRST_EDGE_M = 0.1
_MIN_GROWTH = 1.1  # of the edge, so that the search ends
# Between a line of points (1) and a surface (0.5): few steps, and hardly fewer points than asked for.
_EXPONENT = 0.7


def evenly_thinned(xyz_m: Array, max_points: int) -> Ints:
    """Return the places of at most `max_points` points, ascending: the first of each cube of a grid.

    The edge of the cubes grows until there are few enough of them.

    Args:
        xyz_m: (n, 3) points.
        max_points: The most points that are kept, at least 1.
    """
    kept = np.arange(len(xyz_m))
    edge_m = _FIRST_EDGE_M
    while len(kept) > max_points:
        # A point that shares its cube with an earlier one shares the larger cube as well: only those kept are asked.
        kept = kept[_first_of_cubes(xyz_m[kept], edge_m)]
        edge_m *= max(_MIN_GROWTH, (len(kept) / max_points) ** _EXPONENT)
    return kept


def _first_of_cubes(xyz_m: Array, edge_m: float) -> Ints:
    cells = np.floor(np.asarray(xyz_m, dtype=np.float64) / edge_m).astype(np.int64)
    cells -= cells.min(axis=0)
    width = cells.max(axis=0) + 1
    key = (cells[:, 0] * width[1] + cells[:, 1]) * width[2] + cells[:, 2]
    _, first = np.unique(key, return_index=True)
    return np.sort(first)
