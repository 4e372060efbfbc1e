"""Open land beside the street, by the setting `clutter`: which stretches, and the car parks on some of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.synthetic.ground import END_M, START_M
from upvl_cli.synthetic.kind import Kind
from upvl_cli.synthetic.pedestrians import one_of, standing
from upvl_cli.synthetic.road import Road
from upvl_cli.synthetic.scene import Thing
from upvl_cli.synthetic.way import across_street

LAND_USES = ("bank", "cut", "thicket", "hedge", "meadow", "car park")
_USE_SHARES = (0.26, 0.12, 0.2, 0.16, 0.14, 0.12)
_OPEN_SHARE = 0.75  # of the stretches of a side at clutter 1
_FREE_M = 12.0  # on both sides of the side street's middle
_BAY_M = 2.7  # between the middles of cars side by side


class Stretch(NamedTuple):
    """Open land beside the street.

    Attributes:
        side: 1 left, -1 right.
        first_m: S where it begins.
        last_m: S where it ends.
        use: What is on it, one of `LAND_USES`.
    """

    side: int
    first_m: float
    last_m: float
    use: str


def open_land(road: Road, rng: np.random.Generator, clutter: float) -> list[Stretch]:
    """Choose the stretches without buildings."""
    found = []
    ranges = ((START_M, road.side_s_m - _FREE_M), (road.side_s_m + _FREE_M, END_M))
    for side in (-1, 1):
        for first, last in ranges:
            s = first
            while s < last - 8.0:
                end = min(s + rng.uniform(14.0, 40.0), last)
                use = str(rng.choice(LAND_USES, p=_USE_SHARES))
                if rng.random() < _OPEN_SHARE * clutter:
                    found.append(Stretch(side, float(s), float(end), use))
                s = end + rng.uniform(0.0, 4.0)
    return found


def car_parks(
    road: Road, land: Sequence[Stretch], kinds: Sequence[Kind], density: float, rng: np.random.Generator
) -> list[Thing]:
    """Cars side by side on open land, their fronts or backs to the street."""
    usable = [kind for kind in kinds if "parked" in kind.place]
    found = []
    for stretch in land:
        if stretch.use != "car park" or not usable:
            continue
        for s in np.arange(stretch.first_m + 2.0, stretch.last_m - 2.0, _BAY_M):
            kind, model = one_of(usable, rng)
            length, width, _ = model.size_lwh_m
            if rng.random() > 0.65 * density or width > _BAY_M - 0.3 or length > 6.5:
                continue
            left = bool(rng.random() < 0.5)
            away = road.front_m + 1.6 + length / 2 + rng.uniform(0, 0.4)
            way = across_street(road, float(s + rng.normal(0, 0.08)), left=left)
            found.append(
                Thing(kind, model, standing(way, stretch.side * away if left else -stretch.side * away))
            )
    return found
