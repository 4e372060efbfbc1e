"""Persistent points: those whose place is occupied both before and after a moment.

A moving object leaves its place empty. The measure is the persistence score of You et al., Learning to
Detect Mobile Objects from LiDAR Scans Without Labels (CVPR 2022), over seconds instead of days.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.proposals.config import PersistenceConfig
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Bools, Floats

_ROUNDING_S = 1e-6  # far below the time between sweeps


def occupied_places(xyz_world_m: Floats, *, voxel_m: float) -> cKDTree:
    """Return a tree of the occupied places of a sweep.

    Args:
        xyz_world_m: (n, 3) points above the ground, in world axes.
        voxel_m: Edge of the voxels that the points are merged in.
    """
    return cKDTree(voxelize(xyz_world_m, voxel_m=voxel_m).centroid.reshape(-1, 3))


@dataclass(frozen=True)
class OccupancyHistory:
    """Occupied places above the ground, sweep by sweep, in world axes.

    Attributes:
        time_s: (T,) ascending time of each sweep.
        trees: `occupied_places` of each sweep.
    """

    time_s: Floats
    trees: Sequence[cKDTree]

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


def sliding_history(
    time_s: Floats, trees: Iterable[cKDTree], config: PersistenceConfig
) -> Iterator[tuple[int, OccupancyHistory]]:
    """Yield for each sweep of a drive the sweeps around it that its persistence asks for, and its place in them.

    They reach as far as the longest span with its tolerance, whatever the length of the drive.

    Args:
        time_s: (T,) ascending time of each sweep.
        trees: `occupied_places` of each sweep; taken only as far ahead as they are needed.
        config: Spans, and the tolerance in time.
    """
    reach_s = max(config.spans_s, default=0.0) * (1 + config.time_tolerance) + _ROUNDING_S
    held: deque[cKDTree] = deque()
    coming = iter(trees)
    first = 0
    for step, now_s in enumerate(time_s):
        begin, end = np.searchsorted(time_s, [now_s - reach_s, now_s + reach_s])
        held.extend(next(coming) for _ in range(end - first - len(held)))
        for _ in range(begin - first):
            held.popleft()
        first = int(begin)
        yield step - first, OccupancyHistory(time_s[begin:end], tuple(held))
