"""What stays where it is: places that hold matter both before and after a moment.

A moving object leaves its place empty. The measure is the persistence score of You et al., Learning to
Detect Mobile Objects from LiDAR Scans Without Labels (CVPR 2022), over seconds instead of days.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats

VOXEL_M = 0.15
RADIUS_M = 0.25  # a little more than the edge of a voxel: neighbours of a sampled surface are this close
SLACK = 0.25  # a sweep stands for a time from which it is off by up to this share of the span


@dataclass(frozen=True)
class Places:
    """Where matter stood above the ground, sweep by sweep, in world axes.

    Attributes:
        time_s: (T,) ascending time of each sweep.
        trees: One tree of occupied places a sweep.
    """

    time_s: Floats
    trees: list[cKDTree]

    def lasting(self, step: int, span_s: float, xyz_world_m: Floats) -> Bools:
        """(n,) whether each place is taken a span before and a span after a sweep as well.

        One of the two decides where the drive is not long enough for both, and nothing lasts where it is
        too short for either: no evidence.

        Args:
            step: Number of the sweep.
            span_s: Time to look back and ahead.
            xyz_world_m: (n, 3) places.
        """
        lasting = np.ones(len(xyz_world_m), dtype=np.bool_)
        looked = False
        for then_s in (self.time_s[step] - span_s, self.time_s[step] + span_s):
            other = int(np.argmin(np.abs(self.time_s - then_s)))
            if abs(self.time_s[other] - then_s) <= SLACK * span_s and len(xyz_world_m):
                distance, _ = self.trees[other].query(xyz_world_m, distance_upper_bound=RADIUS_M)
                lasting &= np.isfinite(distance)
                looked = True
        return lasting & looked


def places(time_s: Floats, sweeps_world_m: Iterable[Floats]) -> Places:
    """Remember where matter stood in each sweep.

    Args:
        time_s: (T,) ascending time of each sweep.
        sweeps_world_m: T arrays (n, 3) of points above the ground, in world axes.
    """
    trees = [cKDTree(voxelize(xyz, voxel_m=VOXEL_M).centroid.reshape(-1, 3)) for xyz in sweeps_world_m]
    return Places(np.asarray(time_s, dtype=np.float64), trees)
