"""Ways along the street and off it, which things follow at their own pace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.synthetic.motion import Motion
from upvl_cli.synthetic.road import Road
from upvl_cli.types import Array, Floats

REACH_M = 1500.0  # ways go on beyond the city: a minute's drive must not come to their end
_AHEAD_M = 0.5  # over which heading and slope are told


@dataclass(frozen=True)
class Way:
    """A line on the ground.

    Attributes:
        road: The street.
        knot_m: (k, 3) metres along the way, ascending, and s and d there; straight in between.
    """

    road: Road
    knot_m: Floats

    def places(self, along_m: Array) -> Floats:
        """(n, 3) world places."""
        s, d = (np.interp(along_m, self.knot_m[:, 0], self.knot_m[:, 1 + i]) for i in (0, 1))
        return self.road.place(s, d)

    def motion(self, along_m: Array, first_s: float) -> Motion:
        """Return the motion of what is so far along the way at each sample.

        Args:
            along_m: (k,) metres along the way.
            first_s: Time of the first sample.
        """
        along = np.asarray(along_m, dtype=np.float64)
        if np.ptp(along) == 0:
            along = along[:1]
        ahead = self.places(along + _AHEAD_M) - self.places(along - _AHEAD_M)
        heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
        here = self.places(along)
        to_left = np.column_stack([-np.sin(heading), np.cos(heading)])
        left = here[:, :2] + _AHEAD_M * to_left
        right = here[:, :2] - _AHEAD_M * to_left
        rise = self.road.height(*self.road.coordinates(left)) - self.road.height(
            *self.road.coordinates(right)
        )
        slope = np.column_stack([ahead[:, 2] / np.linalg.norm(ahead[:, :2], axis=1), rise / (2 * _AHEAD_M)])
        # On the edge of a kerb the slope means nothing: what stands there leans on nothing steeper than the street.
        return Motion(here, heading, np.clip(slope, -0.06, 0.06), first_s)


def along_street(road: Road, d_m: float, *, back: bool) -> Way:
    """At one distance from the middle line; `along` is s, or -s where it leads back."""
    sign = -1.0 if back else 1.0
    along = np.arange(-REACH_M, REACH_M, 5.0)
    return Way(road, np.column_stack([along, sign * along, np.full(len(along), d_m)]))


def changing(road: Road, d_m: float, then_d_m: float, *, from_m: float, over_m: float) -> Way:
    """Along the street, and on the way over to another lane."""
    along = np.arange(-REACH_M, REACH_M)
    share = np.clip((along - from_m) / over_m, 0, 1)
    share = share * share * (3 - 2 * share)
    return Way(road, np.column_stack([along, along, d_m + share * (then_d_m - d_m)]))


def across_street(road: Road, s_m: float, *, left: bool) -> Way:
    """Straight across the street at one s; `along` is d, or -d where it leads to the right."""
    sign = 1.0 if left else -1.0
    along = np.arange(-REACH_M, REACH_M, 5.0)
    return Way(road, np.column_stack([along, np.full(len(along), s_m), sign * along]))


def turning_right(road: Road, d_m: float, s_m: float, radius_m: float) -> Way:
    """Along the street, then right into the side street, whose lane lies at s; `along` is s before the turn."""
    first = s_m - radius_m
    angle = np.linspace(0, np.pi / 2, 16)
    arc = np.column_stack(
        [
            first + radius_m * angle,
            first + radius_m * np.sin(angle),
            d_m - radius_m * (1 - np.cos(angle)),
        ]
    )
    before = np.arange(-REACH_M, first - 1, 5.0)
    after = np.arange(1.0, REACH_M, 5.0)
    last = arc[-1]
    return Way(
        road,
        np.concatenate(
            [
                np.column_stack([before, before, np.full(len(before), d_m)]),
                arc,
                np.column_stack([last[0] + after, np.full(len(after), s_m), last[2] - after]),
            ]
        ),
    )
