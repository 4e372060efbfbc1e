"""Who walks, waits and crosses, and what stands about on the pavements and along the kerbs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.synthetic.kind import Kind
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.motion import SAMPLE_HZ, Motion
from upvl_cli.synthetic.road import PARKING_M, PAVEMENT_M, SIDE_HALF_M, Road
from upvl_cli.synthetic.scene import Thing
from upvl_cli.synthetic.traffic import FIRST_S
from upvl_cli.synthetic.way import Way, across_street, along_street

WALKERS = 34
CROSSING = 4
THINGS_ABOUT = 26
_BEGIN_M, _END_M = -60.0, 110.0
CROSSWALK_M = 4.25  # middle of the crosswalk, before the side street


def walkers(
    road: Road, kinds: Sequence[Kind], density: float, *, is_red: bool, samples: int, rng: np.random.Generator
) -> list[Thing]:
    """People, dogs and what they push: on both pavements, at the crosswalk, and some who wait.

    Args:
        road: The street.
        kinds: What there may be, on pavements and elsewhere.
        density: Factor on their number.
        is_red: Whether traffic waits, and people cross.
        samples: How many of each motion.
        rng: Source of all chance.
    """
    time_s = np.arange(samples) / SAMPLE_HZ
    found: list[Thing] = []
    places: list[tuple[float, float]] = []
    pavement = [kind for kind in kinds if "pavement" in kind.place]
    for _ in range(round(density * WALKERS)):
        side, back = float(rng.choice([-1, 1])), bool(rng.random() < 0.5)
        s, off = float(rng.uniform(_BEGIN_M, _END_M)), float(rng.uniform(1.3, PAVEMENT_M - 0.7))
        if abs(s - road.side_s_m) < SIDE_HALF_M + 6 or any(
            abs(s - other_s) < 2.5 and abs(side * off - other) < 1.0 for other_s, other in places
        ):
            continue
        # Now and then two or three go together.
        for number in range(int(rng.choice([1, 2, 3], p=[0.75, 0.2, 0.05]))):
            kind, model = one_of(pavement, rng)
            beside = min(off + 0.75 * number, PAVEMENT_M - 0.5)
            places.append((s, side * beside))
            speed = float(rng.uniform(*kind.speed_mps)) if rng.random() < 0.85 else 0.0
            way = along_street(road, side * (road.kerb_m + beside), back=back)
            found.append(Thing(kind, model, way.motion((-s if back else s) + speed * time_s, FIRST_S)))
    crossing = [kind for kind in kinds if "crossing" in kind.place]
    for number in range(CROSSING):
        kind, model = one_of(crossing, rng)
        left = bool(number % 2)
        s = road.side_s_m - SIDE_HALF_M - CROSSWALK_M + 0.8 * (number - 1.5)
        speed = float(rng.uniform(*kind.speed_mps)) if is_red else 0.0
        start = -(road.kerb_m + 1.0) + (rng.uniform(0, 0.9) * road.kerb_m if is_red else 0.0)
        found.append(
            Thing(kind, model, across_street(road, s, left=left).motion(start + speed * time_s, FIRST_S))
        )
    return found


def parked(road: Road, kinds: Sequence[Kind], density: float, rng: np.random.Generator) -> list[Thing]:
    """Vehicles along both kerbs, close behind each other, with gaps; none near the side street."""
    if not road.parking:
        return []
    usable = [kind for kind in kinds if "parked" in kind.place]
    found = []
    for side in (-1.0, 1.0):
        s = -90.0 + float(rng.uniform(0, 5))
        while s < 140:
            kind, model = one_of(usable, rng)
            length = model.size_lwh_m[0]
            if (
                abs(s + length / 2 - road.side_s_m) > length / 2 + SIDE_HALF_M + 9
                and rng.random() < 0.72 * density
            ):
                d = side * (road.kerb_m - PARKING_M / 2 + float(rng.normal(0, 0.05)))
                back = bool(side > 0)
                middle = s + length / 2
                found.append(
                    Thing(
                        kind, model, standing(along_street(road, d, back=back), -middle if back else middle)
                    )
                )
            s += length + float(rng.uniform(0.7, 2.2))
    return found


def things_about(road: Road, kinds: Sequence[Kind], density: float, rng: np.random.Generator) -> list[Thing]:
    """Bins, cones, barriers and the like, along the houses and at the kerb."""
    usable = [kind for kind in kinds if "roadside" in kind.place]
    found = []
    for _ in range(round(density * THINGS_ABOUT)):
        kind, model = one_of(usable, rng)
        side, s = float(rng.choice([-1, 1])), float(rng.uniform(_BEGIN_M, _END_M))
        if abs(s - road.side_s_m) < SIDE_HALF_M + 4:
            continue
        width = model.size_lwh_m[1]
        off = PAVEMENT_M - 0.15 - width / 2 if rng.random() < 0.6 else 0.25 + width / 2
        way = along_street(road, side * (road.kerb_m + off), back=bool(side > 0))
        found.append(Thing(kind, model, standing(way, -s if side > 0 else s)))
    return found


def one_of(kinds: Sequence[Kind], rng: np.random.Generator) -> tuple[Kind, ObjectModel]:
    """Return a kind by chance, and one of it."""
    share = np.array([kind.share for kind in kinds])
    kind = kinds[rng.choice(len(kinds), p=share / share.sum())]
    return kind, kind.build(rng)


def standing(way: Way, along_m: float) -> Motion:
    """Return the motion of what stands on a way."""
    return way.motion(np.array([along_m]), FIRST_S)
