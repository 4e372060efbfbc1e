"""Filters of a query: bounds on boxes that need no feature."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from upvl_cli.types import Array, Bools


class Filterable(Protocol):
    """Boxes that can be filtered, for example the `Objects` of an index."""

    def __len__(self) -> int: ...

    @property
    def speed_mps(self) -> Array:
        """(n,) horizontal speed over the ground."""

    @property
    def range_m(self) -> Array:
        """(n,) horizontal distance of the centre from the ego origin."""

    @property
    def time_s(self) -> Array:
        """(n,) time since the first frame of the drive."""

    @property
    def confidence(self) -> Array:
        """(n,) score of the box itself, 0 to 1."""


@dataclass(frozen=True)
class Filters:
    """Which boxes a query considers; None sets no bound, and every bound belongs to what passes.

    Attributes:
        segments: Names of the drives; an empty collection takes all.
        moving: True for moving boxes only, False for parked ones only.
        min_speed_mps: Minimum horizontal speed over the ground.
        max_speed_mps: Maximum horizontal speed over the ground.
        max_range_m: Maximum horizontal distance of the centre from the ego origin.
        from_s: Earliest time since the first frame of the drive.
        to_s: Latest time since the first frame of the drive.
        min_confidence: Minimum score of the box itself.
    """

    segments: Collection[str] = ()
    moving: bool | None = None
    min_speed_mps: float | None = None
    max_speed_mps: float | None = None
    max_range_m: float | None = None
    from_s: float | None = None
    to_s: float | None = None
    min_confidence: float | None = None

    def includes(self, segment: str) -> bool:
        """Return whether a drive is considered."""
        return not self.segments or segment in self.segments

    def mask(self, objects: Filterable, moving_mps: float) -> Bools:
        """Return (n,) which boxes pass.

        Args:
            objects: n boxes.
            moving_mps: Minimum speed of a moving box.
        """
        passes = np.ones(len(objects), dtype=np.bool_)
        if self.moving is not None:
            passes &= (objects.speed_mps >= moving_mps) == self.moving
        for name, minimum, maximum in (
            ("speed_mps", self.min_speed_mps, self.max_speed_mps),
            ("range_m", None, self.max_range_m),
            ("time_s", self.from_s, self.to_s),
            ("confidence", self.min_confidence, None),
        ):
            if minimum is not None or maximum is not None:
                values = getattr(objects, name)
                passes &= True if minimum is None else values >= minimum
                passes &= True if maximum is None else values <= maximum
        return passes
