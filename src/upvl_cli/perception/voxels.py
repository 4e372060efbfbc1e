"""Voxel grids: points grouped by cubes, as a sparser stand-in for a dense cloud."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Floats, Ints

_FEWEST_TO_MERGE = 2**16  # voxels: some megabytes


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


class VoxelTotals(NamedTuple):
    """What was added of each of m voxels, in the order in which they were first met.

    Attributes:
        centroid_m: (m, d) mean of the centroids of its points in each sweep.
        sweeps: (m,) sweeps with a point in it.
        weight: (m,) points in it.
        values: (m, k) sums of the values of its points.
    """

    centroid_m: Floats
    sweeps: Floats
    weight: Floats
    values: Floats


class VoxelSums:
    """Sums of values of points by voxel, sweep by sweep: as large as the voxels, however many sweeps there are."""

    def __init__(self, voxel_m: float, columns: int) -> None:
        """Start without any voxel.

        Args:
            voxel_m: Edge of the cubes.
            columns: Number k of values of a point.
        """
        self._voxel_m, self._columns = voxel_m, columns
        # Of each voxel its cell, and the sums of x, y, z, sweeps, points and values. Those of the last sweeps wait in
        # `_parts[1:]` until they are as many as all before them.
        self._parts: list[tuple[Ints, Floats]] = [(np.zeros((0, 3), np.int64), np.zeros((0, 5 + columns)))]

    def add(self, xyz_m: Floats, values: Array) -> None:
        """Add a sweep.

        Args:
            xyz_m: (n, 3) points, in the same axes in every sweep.
            values: (n, k) values of each.
        """
        voxels = voxelize(xyz_m, voxel_m=self._voxel_m)
        centroid_m, total = voxels.centroid.reshape(-1, 3), len(voxels.weight)
        sums = [np.bincount(voxels.of_point, column, total) for column in np.asarray(values).T]
        cell = np.floor(centroid_m / self._voxel_m).astype(np.int64)
        self._parts.append((cell, np.column_stack([centroid_m, np.ones(total), voxels.weight, *sums])))
        if sum(len(cells) for cells, _ in self._parts[1:]) > max(len(self._parts[0][0]), _FEWEST_TO_MERGE):
            self._merge()

    def totals(self) -> VoxelTotals:
        """Return the sums of the sweeps so far."""
        self._merge()
        sums = self._parts[0][1]
        return VoxelTotals(sums[:, :3] / np.maximum(sums[:, 3:4], 1), sums[:, 3], sums[:, 4], sums[:, 5:])

    def _merge(self) -> None:
        cell: Ints = np.concatenate([cells for cells, _ in self._parts])
        sums: Floats = np.concatenate([part for _, part in self._parts])
        number = number_in_order(row_keys(cell))
        total = int(number.max(initial=-1)) + 1
        # Added up in the order of the sweeps: the same bits whenever it is done.
        merged: Floats = np.stack([np.bincount(number, column, total) for column in sums.T], axis=1)
        first = np.zeros(total, dtype=np.int64)
        first[number[::-1]] = np.arange(len(number))[::-1]
        self._parts = [(cell[first], merged)]
