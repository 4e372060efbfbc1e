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
from upvl_cli.perception.voxels import VoxelSums
from upvl_cli.types import Bools, Floats, Ints


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
        self._background = VoxelSums(config.voxel_m, columns=1)

    def add(self, xyz_world_m: Floats, is_background: Bools) -> None:
        """Add a sweep.

        Args:
            xyz_world_m: (n, 3) static points in world axes whose state is known.
            is_background: (n,) whether each is background.
        """
        self._background.add(xyz_world_m, is_background[:, None])

    def memory(self) -> PlaceMemory:
        """Return the memory of the sweeps so far."""
        places = self._background.totals()
        share = places.values[:, 0] / np.maximum(places.weight, 1)
        return PlaceMemory(cKDTree(places.centroid_m), share, self._config)
