"""Puts a stretch of city together from a seed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.geometry.iou import iou_bev
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.synthetic.land import car_parks, open_land
from upvl_cli.synthetic.mesh import Triple
from upvl_cli.synthetic.motion import SAMPLE_HZ, Motion
from upvl_cli.synthetic.pedestrians import parked, things_about, walkers
from upvl_cli.synthetic.road import road
from upvl_cli.synthetic.scene import CityScene, Thing
from upvl_cli.synthetic.surroundings import cluttered, surroundings
from upvl_cli.synthetic.traffic import FIRST_S, traffic
from upvl_cli.types import Boxes, Floats, concat

_CHECKS = 4  # times at which nothing may stand in another thing
_EGO_SIZE_M = (6.0, 2.2, 2.0)
# Each purpose has random numbers of its own, so that a change to one leaves the others as they are.
_ROAD, _AROUND, _LIGHT, _TRAFFIC, _WALKERS, _PARKED, _ABOUT = range(7)
_LAND, _CAR_PARKS, _CLUTTER = range(20, 23)


def build(
    seed: Sequence[int], *, without: Sequence[str], seconds: float, density: float, clutter: float
) -> CityScene:
    """Return a stretch of city.

    Args:
        seed: Numbers that decide everything.
        without: Kinds that are left out.
        seconds: How long things move.
        density: Factor on the number of things.
        clutter: How much open land and growth there is beside the street; 0 for none.
    """

    def chance(purpose: int) -> np.random.Generator:
        return np.random.default_rng([*seed, purpose])

    kinds = [kind for kind in KINDS.values() if kind.name not in without]
    samples = int(np.ceil((seconds - 2 * FIRST_S) * SAMPLE_HZ)) + 1
    street = road(chance(_ROAD))
    is_red = bool(chance(_LIGHT).random() < 0.5)
    driving = traffic(street, kinds, density, is_red=is_red, samples=samples, rng=chance(_TRAFFIC))
    way, along = driving.ego
    ego = way.motion(along, FIRST_S)
    things = [
        *driving.things,
        *parked(street, kinds, density, chance(_PARKED)),
        *walkers(street, kinds, density, is_red=is_red, samples=samples, rng=chance(_WALKERS)),
        *things_about(street, kinds, density, chance(_ABOUT)),
    ]
    land = open_land(street, chance(_LAND), clutter)
    things += car_parks(street, land, kinds, density, chance(_CAR_PARKS))
    around = cluttered(surroundings(street, chance(_AROUND)), street, land, chance(_CLUTTER), clutter)
    return CityScene(_apart(things, ego, seconds), around, ego)


def _apart(things: Sequence[Thing], ego: Motion, seconds: float) -> tuple[Thing, ...]:
    """Return the things without those that would stand in the car or in an earlier one."""
    time_s = np.linspace(0, seconds, _CHECKS)
    of_thing = [
        _boxes(ego, _EGO_SIZE_M, time_s),
        *(_boxes(thing.motion, thing.model.size_lwh_m, time_s) for thing in things),
    ]
    at_time = [concat([boxes[[k]] for boxes in of_thing], Boxes) for k in range(_CHECKS)]
    touch = np.any([iou_bev(boxes, boxes) > 0 for boxes in at_time], axis=0)
    kept = [0]
    for number in range(1, len(of_thing)):
        if not touch[number, kept].any():
            kept.append(number)
    return tuple(things[number - 1] for number in kept[1:])


def _boxes(motion: Motion, size_lwh_m: Triple, time_s: Floats) -> Boxes:
    """Return the box of a thing at each of those times."""
    placed, total = motion.at(time_s), len(time_s)
    heading = np.arctan2(placed.rotation[:, 1, 0], placed.rotation[:, 0, 0])
    return Boxes(
        np.broadcast_to(placed.place_m, (total, 3)),
        np.broadcast_to(size_lwh_m, (total, 3)),
        np.broadcast_to(heading, total),
    )
