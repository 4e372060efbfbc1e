"""A street that curves and climbs, with a side street across it: where things stand, and how high.

Places on it are told by s, metres along its middle line, and d, metres to the left of that line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.types import Array, Floats

FIRST_M, LAST_M = -170.0, 270.0  # s of both ends
STEP_M = 0.5
LANE_M = 3.4
PARKING_M = 2.3
KERB_RISE_M, KERB_RUN_M = 0.13, 0.06
PAVEMENT_M = 3.6
SIDE_HALF_M = 4.6  # of the side street's roadway, which has no parking


@dataclass(frozen=True)
class Road:
    """The street.

    Attributes:
        lanes: Lanes of each direction; traffic keeps right, where d is negative.
        parking: Whether cars park along both kerbs.
        side_s_m: Where the side street crosses.
        turn_rad: How far the street turns to and fro.
        wave_m: Length of such a turn there and back.
        phase_rad: Where in a turn s = 0 lies.
        hill_m: Height of its hills.
        tilt: Slope across.
    """

    lanes: int
    parking: bool
    side_s_m: float
    turn_rad: float
    wave_m: float
    phase_rad: float
    hill_m: float
    tilt: float

    @cached_property
    def _s_m(self) -> Floats:
        return np.arange(FIRST_M, LAST_M + STEP_M / 2, STEP_M)

    @cached_property
    def _line_m(self) -> Floats:
        """(k, 2) the middle line at `_s_m`, through the world's origin at s = 0."""
        middle = self._heading((self._s_m[1:] + self._s_m[:-1]) / 2)
        steps = STEP_M * np.column_stack([np.cos(middle), np.sin(middle)])
        line = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return np.asarray(line - line[np.searchsorted(self._s_m, 0.0)])

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._line_m)

    @property
    def kerb_m(self) -> float:
        """|d| of both kerbs."""
        return self.lanes * LANE_M + (PARKING_M if self.parking else 0.4)

    @property
    def front_m(self) -> float:
        """|d| where the pavements end, and yards or houses begin."""
        return self.kerb_m + KERB_RUN_M + PAVEMENT_M

    def lane_m(self, lane: int) -> float:
        """D of the middle of a lane: 0, 1 from the middle line to the right, -1, -2 those that come towards one."""
        return -(lane + 0.5) * LANE_M

    def heading_rad(self, s_m: Array) -> Floats:
        """Direction of the street at s, counter-clockwise from the world's x."""
        return self._heading(np.asarray(s_m, dtype=np.float64))

    def place(self, s_m: Array, d_m: Array) -> Floats:
        """(..., 3) places on the ground, in world axes."""
        s, d = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(d_m, dtype=np.float64))
        heading = self._heading(s)
        x = np.interp(s, self._s_m, self._line_m[:, 0]) - d * np.sin(heading)
        y = np.interp(s, self._s_m, self._line_m[:, 1]) + d * np.cos(heading)
        return np.stack([x, y, self.height(s, d)], axis=-1)

    def height(self, s_m: Array, d_m: Array) -> Floats:
        """Height of the ground."""
        s, d = np.asarray(s_m, dtype=np.float64), np.asarray(d_m, dtype=np.float64)
        hill = self.hill_m * (np.sin(s / 38 + self.phase_rad) - np.sin(self.phase_rad))
        outside = np.minimum(np.abs(d) - self.kerb_m, np.abs(s - self.side_s_m) - SIDE_HALF_M)
        return np.asarray(hill + self.tilt * d + KERB_RISE_M * np.clip(outside / KERB_RUN_M, 0, 1))

    def coordinates(self, xy_m: Array) -> tuple[Floats, Floats]:
        """S and d of (n, 2) world places near the street."""
        near = self._tree.query(xy_m)[1]
        heading = self._heading(self._s_m[near])
        away = np.asarray(xy_m) - self._line_m[near]
        along = away[:, 0] * np.cos(heading) + away[:, 1] * np.sin(heading)
        across = -away[:, 0] * np.sin(heading) + away[:, 1] * np.cos(heading)
        return self._s_m[near] + along, across

    def _heading(self, s_m: Array) -> Floats:
        turned = np.sin(2 * np.pi * s_m / self.wave_m + self.phase_rad) - np.sin(self.phase_rad)
        return np.asarray(self.turn_rad * turned)


def road(rng: np.random.Generator) -> Road:
    """Return a street by chance."""
    return Road(
        lanes=int(rng.integers(1, 3)),
        parking=bool(rng.random() < 0.75),
        side_s_m=float(rng.uniform(28, 50)),
        turn_rad=float(rng.uniform(0.12, 0.3) * rng.choice([-1, 1])),
        wave_m=float(rng.uniform(220, 360)),
        phase_rad=float(rng.uniform(0, 2 * np.pi)),
        hill_m=float(rng.uniform(0.2, 1.0)),
        tilt=float(rng.uniform(-0.012, 0.012)),
    )
