"""The volume that the detector sees, cut into pillars."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from upvl_cli.detector.config import GridConfig
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Bools

_STRIDE = 8  # pillars: the backbone halves its resolution three times


@dataclass(frozen=True)
class Grid:
    """The volume that the detector sees, in ego axes, metres; seen from above it is cut into square pillars.

    Attributes:
        x_m: Rear and front end.
        y_m: Right and left end.
        z_m: Lowest and largest height.
        pillar_m: Side of a pillar.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    z_m: tuple[float, float]
    pillar_m: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("x_m", self.x_m), ("y_m", self.y_m), ("z_m", self.z_m)):
            if not high > low:
                raise BadInput(f"grid {name} goes from {low} to {high}, expected the smaller number first")
        if not self.pillar_m > 0:
            raise BadInput(f"grid pillar_m is {self.pillar_m}, expected more than 0")

    @classmethod
    def of(cls, config: GridConfig) -> Grid:
        """Return the grid of the settings.

        Raises:
            BadInput: An end is not beyond the other one.
        """
        return cls(
            (config.x_min_m, config.x_max_m),
            (config.y_min_m, config.y_max_m),
            (config.z_min_m, config.z_max_m),
            config.pillar_m,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Pillars along x and along y; those added at the far ends to make eights stay empty."""
        along, across = (
            _STRIDE * ceil((high - low) / self.pillar_m / _STRIDE - 1e-9)
            for low, high in (self.x_m, self.y_m)
        )
        return along, across

    def contains(self, xyz_m: Array) -> Bools:
        """Return (n,) whether points lie in the grid; its far ends are outside.

        Args:
            xyz_m: (n, 3 or more) points x, y, z, ...
        """
        inside = np.ones(len(xyz_m), dtype=np.bool_)
        for axis, (low, high) in enumerate((self.x_m, self.y_m, self.z_m)):
            values = np.ascontiguousarray(xyz_m[:, axis])
            inside &= (values >= low) & (values < high)
        return inside
