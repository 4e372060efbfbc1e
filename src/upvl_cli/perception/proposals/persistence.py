"""Persistent points: those whose place is occupied both before and after a moment.

A moving object leaves its place empty. The measure is the persistence score of You et al., Learning to
Detect Mobile Objects from LiDAR Scans Without Labels (CVPR 2022), over seconds instead of days.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.proposals.config import PersistenceConfig
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats


@dataclass(frozen=True)
class OccupancyHistory:
    """Occupied places above the ground, sweep by sweep, in world axes.

    Attributes:
        time_s: (T,) ascending time of each sweep.
        trees: A tree of the centroids of the occupied voxels of each sweep.
    """

    time_s: Floats
    trees: list[cKDTree]

    @classmethod
    def from_sweeps(
        cls, time_s: Floats, sweeps_world_m: Iterable[Floats], *, voxel_m: float
    ) -> OccupancyHistory:
        """Return the occupied places of the sweeps of a drive.

        Args:
            time_s: (T,) ascending time of each sweep.
            sweeps_world_m: T arrays (n, 3) of points above the ground, in world axes.
            voxel_m: Edge of the voxels that the points of a sweep are merged in.
        """
        trees = [cKDTree(voxelize(xyz, voxel_m=voxel_m).centroid.reshape(-1, 3)) for xyz in sweeps_world_m]
        return cls(np.asarray(time_s, dtype=np.float64), trees)

    def is_persistent(
        self, step: int, span_s: float, xyz_world_m: Floats, config: PersistenceConfig
    ) -> Bools:
        """Return (n,) whether each place is occupied both a span before and a span after a sweep.

        Where the drive holds only one of the two times, that one decides. Where it holds neither, there is no
        evidence, and no place is persistent.

        Args:
            step: Number of the sweep.
            span_s: Time to look back and ahead.
            xyz_world_m: (n, 3) places.
            config: What counts as the same place and as the same time.
        """
        persistent = np.ones(len(xyz_world_m), dtype=np.bool_)
        has_evidence = False
        for time_s in (self.time_s[step] - span_s, self.time_s[step] + span_s):
            nearest = int(np.argmin(np.abs(self.time_s - time_s)))
            is_in_time = abs(self.time_s[nearest] - time_s) <= config.time_tolerance * span_s
            if is_in_time and len(xyz_world_m):
                distance, _ = self.trees[nearest].query(xyz_world_m, distance_upper_bound=config.radius_m)
                persistent &= np.isfinite(distance)
                has_evidence = True
        return persistent & has_evidence
