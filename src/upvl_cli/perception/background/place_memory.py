"""What a camera saw of a place at another time: the drive's memory of its background.

What stands still is the same whenever it is seen. A point behind the car, or hidden by a car that passes, takes
the state of its place in the sweeps in which a camera saw that (an addition to UP-VL, whose rule is a sweep's own).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Array, Bools, Floats, Ints

VOXEL_M = 0.25
RADIUS_M = 0.4  # surfaces are sampled anew each time


@dataclass(frozen=True)
class Remembered:
    """Places in world axes that were seen.

    Attributes:
        tree: Where.
        share: (p,) share of what was seen at each that was background.
    """

    tree: cKDTree
    share: Floats

    def of(self, xyz_world_m: Floats) -> Ints:
        """(n,) int8: 1 where background was seen there, 0 where something else, `UNKNOWN` where nothing."""
        state = np.full(len(xyz_world_m), UNKNOWN, dtype=np.int8)
        if self.tree.n and len(xyz_world_m):
            distance, place = self.tree.query(xyz_world_m, distance_upper_bound=RADIUS_M)
            found = np.isfinite(distance)
            state[found] = self.share[place[found]] >= 0.5
        return state


def remember(sweeps: Iterable[tuple[Floats, Bools]]) -> Remembered:
    """Keep what was seen of what stands.

    Args:
        sweeps: For each sweep (n, 3) points in world axes whose state is known, and (n,) whether it is background.
    """
    places: list[Floats] = [np.zeros((0, 3))]
    seen: list[Array] = [np.zeros(0)]
    background: list[Array] = [np.zeros(0)]
    for xyz_m, is_background in sweeps:
        voxels = voxelize(xyz_m, voxel_m=VOXEL_M)
        places.append(voxels.centroid.reshape(-1, 3))
        seen.append(voxels.weight)
        background.append(np.bincount(voxels.of_point, is_background, len(voxels.weight)))
    # Places of all sweeps are gathered once more; each counts with its points.
    voxels = voxelize(np.concatenate(places), voxel_m=VOXEL_M)
    total = len(voxels.weight)
    points = np.bincount(voxels.of_point, np.concatenate(seen), total)
    share = np.bincount(voxels.of_point, np.concatenate(background), total) / np.maximum(points, 1)
    return Remembered(cKDTree(voxels.centroid.reshape(-1, 3)), share)
