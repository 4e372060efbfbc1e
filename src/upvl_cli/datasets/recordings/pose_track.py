"""Poses over time, looked up at the time of a sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.path import pose_at
from upvl_cli.types import Array

NO_POSE = "sweeps without a pose at their time"
# A pose is trusted that far beyond the first and the last, and between two that are so far apart.
_MOST_BEYOND_NS = 100_000_000
_MOST_GAP_NS = 2_000_000_000


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Poses at ascending times.

    Attributes:
        times_ns: (n,) int64.
        poses: (n, 4, 4).
    """

    times_ns: Array
    poses: Array

    @classmethod
    def in_time_order(cls, times_ns: Array, poses: Array) -> PoseTrack:
        """Return poses in the order of their times; of those of one time the first."""
        times, first = np.unique(times_ns, return_index=True)
        return cls(times, poses[first])

    def at(self, time_ns: int) -> Array | None:
        """Return the (4, 4) pose at a time, on the way between its neighbours; None where there is none near."""
        if not len(self.times_ns):
            return None
        if not self.times_ns[0] - _MOST_BEYOND_NS <= time_ns <= self.times_ns[-1] + _MOST_BEYOND_NS:
            return None
        after = int(np.clip(np.searchsorted(self.times_ns, time_ns), 1, max(len(self.times_ns) - 1, 1)))
        if len(self.times_ns) > 1 and self.times_ns[after] - self.times_ns[after - 1] > _MOST_GAP_NS:
            near = int(np.abs(self.times_ns - time_ns).argmin())
            if abs(int(self.times_ns[near]) - time_ns) > 1_000_000:
                return None
            return np.asarray(self.poses[near])
        return pose_at(self.times_ns, self.poses, time_ns)  # type: ignore[arg-type]
