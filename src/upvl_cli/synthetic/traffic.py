"""Vehicles on their lanes: they follow, queue, stop, turn and change lanes.

Each lane is simulated with the Intelligent Driver ObjectModel (Treiber, Hennecke and Helbing, Physical Review E
62, 2000, equations 1 to 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.synthetic.kind import CYCLIST, Kind
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.motion import SAMPLE_HZ
from upvl_cli.synthetic.road import LANE_M, SIDE_HALF_M, Road
from upvl_cli.synthetic.scene import Thing
from upvl_cli.synthetic.way import Way, across_street, along_street, changing, turning_right
from upvl_cli.types import Floats

FIRST_S = -1.0  # time of the first sample
ACCELERATION, BRAKING = 1.4, 2.2  # m/s2, comfortable
GAP_M, HEADWAY_S = 2.2, 1.2
LEAST_GAP_M = 0.3
LEAST_ACCELERATION = -6.0
STOP_LINE_M = 7.5  # before the side street, and so before the crosswalk
EGO_LENGTH_M = 4.8
TURN_RADIUS_M, TURN_MPS = 7.0, 5.0
_STRETCH_M = (-95.0, 150.0)  # of the street that has traffic
_SIDE_BEGIN_M = -65.0
_FREE_AROUND_EGO_M = 9.0


@dataclass
class Driver:
    """One vehicle on a lane.

    Attributes:
        way: What it follows.
        along_m: Where its middle is on the way at the first sample.
        speed_mps: Its speed then.
        wish_mps: The speed it would like.
        length_m: Of the vehicle.
        thing: What it is; None for the car with the sensors.
        turns_at_m: From where on it drives no faster than `TURN_MPS`; infinite where it goes straight on.
    """

    way: Way
    along_m: float
    speed_mps: float
    wish_mps: float
    length_m: float
    thing: tuple[Kind, ObjectModel] | None = None
    turns_at_m: float = np.inf


def follow(lane: Sequence[Driver], stop_m: float, samples: int) -> Floats:
    """(drivers, samples) where each driver of a lane is along its way, in the order given.

    Args:
        lane: The drivers.
        stop_m: Where who has not passed must stop; infinite for a green light.
        samples: How many, `SAMPLE_HZ` a second.
    """
    order = np.argsort([-driver.along_m for driver in lane])
    drivers = [lane[place] for place in order]
    length = np.array([driver.length_m for driver in drivers])
    wish = np.array([driver.wish_mps for driver in drivers])
    turn = np.array([driver.turns_at_m for driver in drivers])
    along = np.array([driver.along_m for driver in drivers])
    speed = np.array([driver.speed_mps for driver in drivers])
    out = np.zeros((len(lane), samples))
    for sample in range(samples):
        out[order, sample] = along
        front = along + length / 2
        rear_ahead = np.append(np.inf, (along - length / 2)[:-1])
        speed_ahead = np.append(0.0, speed[:-1])
        waits = (front < stop_m) & (stop_m < rear_ahead)
        gap = np.maximum(np.where(waits, stop_m, rear_ahead) - front, 0.1)
        closing = speed - np.where(waits, 0.0, speed_ahead)
        least = GAP_M * np.where(waits, 0.3, 1.0)
        desired = least + np.maximum(
            speed * HEADWAY_S + speed * closing / (2 * np.sqrt(ACCELERATION * BRAKING)), 0
        )
        wanted = np.where(along > turn, np.minimum(wish, TURN_MPS), wish)
        change = ACCELERATION * (1 - (speed / wanted) ** 4 - (desired / gap) ** 2)
        change = np.clip(change, LEAST_ACCELERATION, ACCELERATION)
        # Nobody drives into who is in front, however late he saw him.
        room = np.maximum(gap - LEAST_GAP_M, 0) * SAMPLE_HZ
        speed = np.clip(speed + change / SAMPLE_HZ, 0, room)
        along = along + speed / SAMPLE_HZ
    return out


@dataclass(frozen=True)
class Traffic:
    """What drives.

    Attributes:
        things: The vehicles.
        ego: Way and (samples,) progress of the car that carries the sensors.
    """

    things: tuple[Thing, ...]
    ego: tuple[Way, Floats]


def traffic(
    road: Road, kinds: Sequence[Kind], density: float, *, is_red: bool, samples: int, rng: np.random.Generator
) -> Traffic:
    """Fill the lanes of both streets and let them drive.

    Args:
        road: The street.
        kinds: What there may be, on lanes and elsewhere.
        density: Factor on how many there are.
        is_red: Whether the main street has to stop and the side street may go.
        samples: How many of each motion.
        rng: Source of all chance.
    """
    kinds = [kind for kind in kinds if "lane" in kind.place]
    ego = _ego(road, is_red, rng)
    ego_lane = int(round(-ego.way.knot_m[0, 2] / LANE_M - 0.5))
    stop_m = road.side_s_m - SIDE_HALF_M - STOP_LINE_M
    lanes: list[tuple[list[Driver], float]] = []
    for lane in range(road.lanes):
        is_outer = lane == road.lanes - 1
        ahead = along_street(road, road.lane_m(lane), back=False)
        drivers = _queue(ahead, kinds, density, is_outer, ego if lane == ego_lane else None, rng)
        if lane == 1 and lane != ego_lane and drivers:
            _change_lane(drivers, road, rng)
        lanes.append((drivers, stop_m if is_red else np.inf))
        back = along_street(road, -road.lane_m(lane), back=True)
        against_m = -(road.side_s_m + SIDE_HALF_M + 3.0)
        lanes.append((_queue(back, kinds, density, is_outer, None, rng), against_m if is_red else np.inf))
    for left in (True, False):
        way = across_street(road, road.side_s_m + (2.3 if left else -2.3), left=left)
        waits_m = np.inf if is_red else -(road.kerb_m + 3.0)
        stretch_m = (_SIDE_BEGIN_M, -(road.kerb_m + 12))
        drivers = _queue(way, kinds, density, False, None, rng, stretch_m)
        lanes.append((drivers, waits_m))
    things, ego_along = [], np.zeros(samples)
    for drivers, line_m in lanes:
        for driver, along in zip(drivers, follow(drivers, line_m, samples), strict=True):
            if driver.thing is None:
                ego_along = along
            else:
                things.append(Thing(*driver.thing, driver.way.motion(along, FIRST_S)))
    return Traffic(tuple(things), (ego.way, ego_along))


def _ego(road: Road, is_red: bool, rng: np.random.Generator) -> Driver:
    """Return the car with the sensors: at s = 0 at first; it may turn right where the light lets it."""
    lane = int(rng.integers(road.lanes))
    speed = float(rng.uniform(6.0, 10.5))
    turns = lane == road.lanes - 1 and not is_red and rng.random() < 0.5
    if turns:
        way = turning_right(road, road.lane_m(lane), road.side_s_m - 2.3, TURN_RADIUS_M)
        return Driver(way, 0.0, speed, speed, EGO_LENGTH_M, turns_at_m=road.side_s_m - 22)
    return Driver(along_street(road, road.lane_m(lane), back=False), 0.0, speed, speed * 1.1, EGO_LENGTH_M)


def _queue(
    way: Way,
    kinds: Sequence[Kind],
    density: float,
    is_outer: bool,
    ego: Driver | None,
    rng: np.random.Generator,
    stretch_m: tuple[float, float] = _STRETCH_M,
) -> list[Driver]:
    """Vehicles one behind the other; who rides a bicycle keeps to the outermost lane."""
    usable = [kind for kind in kinds if is_outer or kind.type != CYCLIST]
    share = np.array([kind.share for kind in usable])
    drivers = [] if ego is None else [ego]
    along = stretch_m[0] + rng.uniform(0, 20)
    pace = rng.uniform(0.75, 1.1)
    while along < stretch_m[1]:
        kind = usable[rng.choice(len(usable), p=share / share.sum())]
        model = kind.build(rng)
        length = model.size_lwh_m[0]
        middle = along + length / 2
        if ego is None or abs(middle - ego.along_m) > length / 2 + _FREE_AROUND_EGO_M:
            wish = float(rng.uniform(*kind.speed_mps) * pace)
            drivers.append(Driver(way, middle, 0.8 * wish, wish, length, (kind, model)))
        along += length + GAP_M + rng.gamma(1.6, 7.0) / max(density, 1e-2)
    return drivers


def _change_lane(drivers: Sequence[Driver], road: Road, rng: np.random.Generator) -> None:
    """Let the front one of a lane that has room move over to the inner lane, as who overtakes does."""
    front = max(drivers, key=lambda driver: driver.along_m)
    front.way = changing(
        road, road.lane_m(1), road.lane_m(0), from_m=front.along_m + float(rng.uniform(5, 15)), over_m=32.0
    )
