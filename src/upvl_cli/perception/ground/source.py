"""What some drives know beside their points: the height of the ground, and how many points they left out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from upvl_cli.types import Array, Floats


@runtime_checkable
class GroundSource(Protocol):
    """A drive with a map of ground heights."""

    def ground_z(self, frame: int, xyz_ego_m: Array) -> Floats:
        """Return (n,) the height of the ground at each place, along the z axis of the ego; NaN where unknown.

        Args:
            frame: Index of the frame.
            xyz_ego_m: (n, 3) places in the ego axes of that frame.
        """


@runtime_checkable
class IncompleteSweeps(Protocol):
    """A drive that leaves points out of its sweeps and says how many."""

    @property
    def skipped_points(self) -> Mapping[int, Mapping[str, int]]:
        """How many points were left out of each sweep that was read, by frame and reason."""
