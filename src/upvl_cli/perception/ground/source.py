"""The height of the ground, for data sets that have a map of it."""

from __future__ import annotations

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
