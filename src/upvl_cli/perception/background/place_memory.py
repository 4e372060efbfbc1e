"""Background state of places, remembered from other times of a drive.

What is static is the same whenever it is seen. A point behind the car, or hidden by a passing car, takes the state
of its place in the sweeps in which a camera saw it (an addition to UP-VL, which classifies each sweep alone).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.background.config import PlaceMemoryConfig
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Array, Bools, Floats, Ints


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

    @classmethod
    def fit(cls, sweeps: Iterable[tuple[Floats, Bools]], config: PlaceMemoryConfig) -> Self:
        """Return the memory of the static points that were seen.

        Args:
            sweeps: For each sweep (n, 3) points in world axes whose state is known, and (n,) whether each is
                background.
            config: Size of a place, and when it is background.
        """
        places: list[Floats] = [np.zeros((0, 3))]
        points: list[Array] = [np.zeros(0)]
        background: list[Array] = [np.zeros(0)]
        for xyz_m, is_background in sweeps:
            voxels = voxelize(xyz_m, voxel_m=config.voxel_m)
            places.append(voxels.centroid.reshape(-1, 3))
            points.append(voxels.weight)
            background.append(np.bincount(voxels.of_point, is_background, len(voxels.weight)))
        # The places of all sweeps are merged once more; each counts with its points.
        voxels = voxelize(np.concatenate(places), voxel_m=config.voxel_m)
        count = len(voxels.weight)
        total = np.bincount(voxels.of_point, np.concatenate(points), count)
        share = np.bincount(voxels.of_point, np.concatenate(background), count) / np.maximum(total, 1)
        return cls(cKDTree(voxels.centroid.reshape(-1, 3)), share, config)

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
