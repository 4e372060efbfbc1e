"""Background state of places, remembered from other times of a drive.

What is static is the same whenever it is seen. A point behind the car, or hidden by a passing car, takes the state
of its place in the sweeps in which a camera saw it (an addition to UP-VL, which classifies each sweep alone).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.background.config import PlaceMemoryConfig
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.voxels import number_in_order, row_keys, voxelize
from upvl_cli.types import Bools, Floats, Ints

_FEWEST_TO_MERGE = 2**16  # places: a few megabytes


@dataclass(frozen=True)
class PlaceMemory:
    """Static places in world axes that a camera saw.

    Attributes:
        tree: Their p positions.
        share: (p,) share of background among the points seen at each.
        config: Size of a place, and when it is background.
    """

    tree: cKDTree
    share: Floats
    config: PlaceMemoryConfig

    def lookup(self, xyz_world_m: Floats) -> Ints:
        """Return (n,) int8: 1 where background was seen, 0 where something else, `UNKNOWN` where nothing.

        Args:
            xyz_world_m: (n, 3) points in world axes.
        """
        state = np.full(len(xyz_world_m), UNKNOWN, dtype=np.int8)
        if self.tree.n and len(xyz_world_m):
            distance, place = self.tree.query(xyz_world_m, distance_upper_bound=self.config.radius_m)
            found = np.isfinite(distance)
            state[found] = self.share[place[found]] >= self.config.min_background_share
        return state


class PlaceSums:
    """What was seen of each place, summed up sweep by sweep: as large as the places, however often they are seen."""

    def __init__(self, config: PlaceMemoryConfig) -> None:
        """Start without any place.

        Args:
            config: Size of a place, and when it is background.
        """
        self._config = config
        # Of each place its voxel, and the sums of x, y, z, sweeps, points, and points of background. The places of
        # the last sweeps wait in `_parts[1:]` until they are as many as all before them.
        self._parts: list[tuple[Ints, Floats]] = [(np.zeros((0, 3), np.int64), np.zeros((0, 6)))]

    def add(self, xyz_world_m: Floats, is_background: Bools) -> None:
        """Add a sweep.

        Args:
            xyz_world_m: (n, 3) static points in world axes whose state is known.
            is_background: (n,) whether each is background.
        """
        voxels = voxelize(xyz_world_m, voxel_m=self._config.voxel_m)
        centroid, total = voxels.centroid.reshape(-1, 3), len(voxels.weight)
        background = np.bincount(voxels.of_point, is_background, total)
        cell = np.floor(centroid / self._config.voxel_m).astype(np.int64)
        self._parts.append((cell, np.column_stack([centroid, np.ones(total), voxels.weight, background])))
        if sum(len(cells) for cells, _ in self._parts[1:]) > max(len(self._parts[0][0]), _FEWEST_TO_MERGE):
            self._merge()

    def memory(self) -> PlaceMemory:
        """Return the memory of the sweeps so far."""
        self._merge()
        sums = self._parts[0][1]
        centroid = sums[:, :3] / np.maximum(sums[:, 3], 1)[:, None]
        return PlaceMemory(cKDTree(centroid), sums[:, 5] / np.maximum(sums[:, 4], 1), self._config)

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
