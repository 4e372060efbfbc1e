"""The part of the ground around the car that is scored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import BadSetting
from upvl_cli.types import Array, Bools


@dataclass(frozen=True)
class Region:
    """A rectangle around the car: `length_m` along its axis, `width_m` across."""

    length_m: float
    width_m: float

    @classmethod
    def parse(cls, text: str) -> Region:
        """Return the region that a text such as `100x40` names.

        Raises:
            BadSetting: It is not two positive numbers.
        """
        try:
            length_m, width_m = (float(part) for part in text.lower().split("x"))
        except ValueError:
            length_m = width_m = 0.0
        if not (0 < length_m < np.inf and 0 < width_m < np.inf):
            raise BadSetting(
                f"--region {text!r}: expected length x width in metres around the car, such as 100x40"
            )
        return cls(length_m, width_m)

    def contains(self, xyz_ego_m: Array) -> Bools:
        """Return (n,) whether each place lies inside; the edge belongs to it.

        Args:
            xyz_ego_m: (n, 3) places in ego axes; their height does not matter.
        """
        x, y = np.abs(xyz_ego_m[:, :2]).T
        return np.asarray((x <= self.length_m / 2) & (y <= self.width_m / 2))
