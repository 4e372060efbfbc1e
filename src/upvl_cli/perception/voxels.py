"""Voxel grids: points grouped by cubes, as a sparser stand-in for a dense cloud."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.types import Floats, Ints


class Voxels(NamedTuple):
    """The occupied cubes of a grid, in the order of their first point.

    Attributes:
        of_point: (n,) number of the voxel that holds each point.
        centroid: (m, d) mean of the points of each voxel, float64.
        weight: (m,) points in each voxel.
    """

    of_point: Ints
    centroid: Floats
    weight: Ints


def voxelize(points: Floats, *, voxel_m: float) -> Voxels:
    """Group points by the cube of a fixed grid that they fall in.

    Args:
        points: (n, d) finite positions, in any number of dimensions.
        voxel_m: Edge of the cubes.

    Returns:
        The occupied voxels.
    """
    columns = np.ascontiguousarray(np.transpose(points), dtype=np.float64)  # else each pass is a stride
    of_point = number_in_order(row_keys(np.floor(columns / voxel_m).astype(np.int64).T))
    total = int(of_point.max()) + 1 if len(of_point) else 0
    weight = np.bincount(of_point, minlength=total)
    sums = [np.bincount(of_point, weights=column, minlength=total) for column in columns]
    return Voxels(of_point, np.stack(sums, axis=1) / np.maximum(weight, 1)[:, None], weight)


def row_keys(cells: Ints) -> Ints:
    """Give each row of integers one number, equal exactly for equal rows.

    Args:
        cells: (n, d) integers.

    Returns:
        (n,) keys, in the rows' own (first column first) order.
    """
    keys = np.zeros(len(cells), dtype=np.int64)
    if not len(cells):
        return keys
    extents = cells.max(axis=0) - cells.min(axis=0) + 1
    used = 1
    for column, low, extent in zip(cells.T, cells.min(axis=0), extents, strict=True):
        if used * int(extent) >= 2**62:  # would not fit: number the keys so far anew, without gaps
            keys = np.unique(keys, return_inverse=True)[1].astype(np.int64)
            used = int(keys.max()) + 1
        keys = keys * extent + (column - low)
        used *= int(extent)
    return keys


def number_in_order(keys: Ints) -> Ints:
    """Renumber keys 0, 1, 2... by where each is first met.

    Args:
        keys: (n,) integers.

    Returns:
        (n,) numbers without gaps.
    """
    if not len(keys):
        return np.zeros(0, dtype=np.int64)
    order = np.argsort(keys)
    ordered = keys[order]
    begins = np.append(True, ordered[1:] != ordered[:-1])
    first = np.minimum.reduceat(order, np.flatnonzero(begins))
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    numbers = np.empty(len(keys), dtype=np.int64)
    numbers[order] = rank[np.cumsum(begins) - 1]
    return numbers
