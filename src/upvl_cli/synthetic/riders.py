"""Those who ride on two wheels: cyclists, motorcyclists and people on electric scooters."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.bodywork import block, both, pick, ring, spokes, varied
from upvl_cli.synthetic.figure import TOPS, Appearance, head, look, reach, seated_leg, torso
from upvl_cli.synthetic.mesh import Mesh, Triple, ellipsoid, prism, tube
from upvl_cli.synthetic.model import ObjectModel, Part
from upvl_cli.synthetic.surface import (
    CHROME,
    DARK,
    HEADLIGHT,
    PLATE,
    RUBBER,
    STEEL,
    TAILLIGHT,
    Finish,
    cloth,
    paint,
)

_HELMETS = ((236, 236, 232), (30, 30, 34), (200, 30, 36), (36, 90, 190), (240, 210, 40))


def _bar(start: Triple, end: Triple, radius: float, surface: Finish) -> Mesh:
    return tube(start, end, radius, surface, sides=5)


def _bicycle(frame: Finish) -> list[Mesh]:
    rear, front, crank = (-0.52, 0.0, 0.34), (0.54, 0.0, 0.34), (-0.06, 0.0, 0.28)
    seat, steer = (-0.22, 0.0, 0.86), (0.36, 0.0, 0.86)
    parts = [ring((x, 0.0, 0.34), 0.34, 0.04, RUBBER, 18) for x in (rear[0], front[0])]
    parts += [spokes((x, 0.0, 0.34), 0.31, STEEL) for x in (rear[0], front[0])]
    for start, end in (
        (crank, seat),
        (crank, steer),
        (seat, steer),
        (rear, seat),
        (rear, crank),
        (front, steer),
    ):
        parts.append(_bar(start, end, 0.02, frame))
    parts += [_bar(seat, (-0.24, 0.0, 0.95), 0.015, STEEL), _bar(steer, (0.33, 0.0, 1.02), 0.015, STEEL)]
    parts.append(_bar((0.35, -0.29, 1.03), (0.35, 0.29, 1.03), 0.016, DARK))
    parts.append(prism([(-0.38, 0.95), (-0.1, 0.95), (-0.1, 0.99), (-0.38, 1.0)], 0.14, DARK, 0.02))
    parts.append(tube((-0.06, -0.02, 0.28), (-0.06, 0.06, 0.28), 0.09, STEEL))
    parts += [block((0.4, 0.46), (-0.04, 0.04), (0.86, 0.94), HEADLIGHT)]
    parts.append(block((-0.46, -0.43), (-0.03, 0.03), (0.78, 0.84), TAILLIGHT))
    return parts


def _sitting(
    who: Appearance, hip: Triple, neck: Triple, hand: Triple, helmet: Finish | None
) -> list[Part | Mesh]:
    """Return the upper body of somebody who holds a handlebar."""
    share = 0.88
    shoulder = (hip[0] + share * (neck[0] - hip[0]), hip[2] + share * (neck[2] - hip[2]))
    return [torso(who, hip, neck), head(who, neck, helmet), reach(who, *shoulder, hand)]


def cyclist(rng: np.random.Generator) -> ObjectModel:
    """Somebody on a bicycle, whose legs pedal; at times with a helmet, a basket or a bag."""
    who = look(rng)._replace(height_m=float(rng.uniform(1.65, 1.85)), girth=float(rng.uniform(0.88, 1.05)))
    helmet = paint(pick(rng, _HELMETS)) if rng.random() < 0.6 else None
    hip = (-0.24, 0.0, 1.04)
    neck = (float(rng.uniform(-0.1, 0.1)), 0.0, 1.04 + 0.3 * who.height_m)
    parts: list[Part | Mesh] = [*_bicycle(paint(pick(rng, TOPS)))]
    parts += _sitting(who, hip, neck, (0.33, 0.27, 1.05), helmet)
    for way, up in ((1, 0.16), (-1, -0.12)):
        y = way * 0.1
        foot = (-0.06 + 0.06 * way, y, 0.28 + up)
        knee = (0.2, y, 0.76 + up * 0.6)
        parts.append(
            Part(seated_leg(who, (-0.22, y, 1.02), knee, foot), 0.12, (-0.22, y, 1.02), (1 - way) * np.pi / 2)
        )
    extra = int(rng.integers(4))
    if extra == 0:
        parts.append(block((0.42, 0.7), (-0.17, 0.17), (0.97, 1.2), cloth((120, 92, 60))))
    elif extra == 1:
        parts.append(both((-0.72, -0.36), (0.06, 0.2), (0.42, 0.76), cloth(pick(rng, TOPS))))
    elif extra == 2:
        bag = cloth(pick(rng, ((0, 190, 180), (250, 130, 20), (40, 40, 44))))
        parts.append(block((neck[0] - 0.52, neck[0] - 0.19), (-0.2, 0.2), (1.12, 1.52), bag))
    return varied(rng, parts, 0.02)


def _motorcycle(lacquer: Finish) -> list[Mesh]:
    parts = []
    for x, half in ((-0.68, 0.08), (0.72, 0.055)):
        parts.append(tube((x, -half, 0.31), (x, half, 0.31), 0.31, RUBBER, sides=16))
        parts.append(tube((x, -half - 0.008, 0.31), (x, half + 0.008, 0.31), 0.2, STEEL, sides=10))
    tank = [(-0.15, 0.72), (0.35, 0.72), (0.42, 0.88), (0.3, 1.0), (0.05, 1.0), (-0.15, 0.86)]
    rear = [(-0.8, 0.68), (-0.1, 0.66), (-0.1, 0.78), (-0.75, 0.84), (-1.02, 0.92), (-1.02, 0.84)]
    fairing = [(0.3, 0.75), (0.62, 0.7), (0.72, 0.9), (0.5, 1.16), (0.35, 1.05)]
    parts += [
        prism(tank, 0.3, lacquer, 0.05),
        prism(rear, 0.24, lacquer, 0.02),
        prism(fairing, 0.34, lacquer, 0.08),
    ]
    parts += [
        block((-0.3, 0.35), (-0.17, 0.17), (0.28, 0.7), DARK),
        block((-0.72, -0.14), (-0.14, 0.14), (0.79, 0.89), DARK),
    ]
    parts.append(tube((0.1, -0.2, 0.33), (-0.85, -0.22, 0.42), 0.055, CHROME, sides=8))
    parts += [_bar((0.72, y, 0.31), (0.42, y, 1.0), 0.028, CHROME) for y in (-0.1, 0.1)]
    parts += [_bar((-0.68, y, 0.31), (-0.1, y, 0.45), 0.03, STEEL) for y in (-0.12, 0.12)]
    parts.append(_bar((0.38, -0.37, 1.07), (0.38, 0.37, 1.07), 0.02, DARK))
    parts += [ellipsoid((0.12, 0.2, 0.2), (0.68, 0.0, 0.9), HEADLIGHT, sides=8)]
    parts.append(block((-1.06, -1.0), (-0.08, 0.08), (0.85, 0.91), TAILLIGHT))
    parts += [
        block((-1.0, -0.96), (-0.1, 0.1), (0.52, 0.7), PLATE),
        block((-0.97, -0.6), (-0.05, 0.05), (0.62, 0.72), DARK),
    ]
    fender = [(0.45, 0.58), (0.97, 0.58), (0.9, 0.66), (0.72, 0.69), (0.54, 0.66)]
    parts += [prism(fender, 0.15, lacquer), both((0.3, 0.34), (0.3, 0.44), (1.12, 1.22), DARK)]
    return parts


def motorcyclist(rng: np.random.Generator) -> ObjectModel:
    """Somebody with a helmet on a motorcycle."""
    dark = cloth(pick(rng, ((34, 34, 38), (34, 34, 38), (70, 40, 30), (150, 30, 34))))
    who = look(rng)._replace(height_m=float(rng.uniform(1.68, 1.88)), top=dark, trousers=cloth((36, 38, 44)))
    lacquer = paint(pick(rng, ((196, 26, 30), (28, 28, 32), (30, 70, 170), (236, 150, 30), (60, 140, 60))))
    neck = (0.02, 0.0, 0.95 + 0.31 * who.height_m)
    helmet = paint(pick(rng, _HELMETS))
    parts: list[Part | Mesh] = [*_motorcycle(lacquer)]
    parts += _sitting(who, (-0.3, 0.0, 0.95), neck, (0.37, 0.32, 1.09), helmet)
    size = 0.13 * who.height_m
    middle = neck[2] + 0.028 * who.height_m + size / 2
    parts.append(ellipsoid((1.2 * size, size, 1.15 * size), (neck[0], 0, middle + 0.02), helmet))
    parts.append(block((neck[0] + 0.1, neck[0] + 0.15), (-0.08, 0.08), (middle - 0.02, middle + 0.07), DARK))
    for way in (1, -1):
        y = way * 0.2
        parts.append(seated_leg(who, (-0.28, way * 0.11, 0.95), (0.16, y, 0.82), (-0.12, y, 0.4)))
    if rng.random() < 0.35:
        parts.append(block((-1.08, -0.7), (-0.2, 0.2), (0.93, 1.25), DARK))
    return varied(rng, parts, 0.03)


def scooter_rider(rng: np.random.Generator) -> ObjectModel:
    """Somebody who stands on an electric kick scooter."""
    who = look(rng)
    accent = paint(pick(rng, ((40, 200, 90), (250, 130, 20), (30, 30, 34), (220, 30, 60), (230, 220, 40))))
    parts: list[Part | Mesh] = []
    for x in (-0.5, 0.5):
        parts.append(tube((x, -0.025, 0.11), (x, 0.025, 0.11), 0.11, RUBBER, sides=12))
        parts.append(tube((x, -0.034, 0.11), (x, 0.034, 0.11), 0.06, STEEL, sides=8))
    parts += [
        block((-0.42, 0.36), (-0.09, 0.09), (0.12, 0.17), accent),
        block((-0.34, 0.3), (-0.08, 0.08), (0.16, 0.18), DARK),
    ]
    parts.append(prism([(-0.64, 0.18), (-0.4, 0.15), (-0.42, 0.24), (-0.6, 0.26)], 0.08, accent))
    parts += [
        _bar((0.5, 0.0, 0.12), (0.36, 0.0, 1.08), 0.028, accent),
        _bar((0.36, -0.27, 1.08), (0.36, 0.27, 1.08), 0.02, DARK),
    ]
    parts.append(prism([(0.3, 0.15), (0.46, 0.2), (0.44, 0.34), (0.4, 0.34)], 0.05, accent))
    parts += [
        block((0.4, 0.46), (-0.03, 0.03), (0.92, 0.98), HEADLIGHT),
        block((-0.66, -0.6), (-0.03, 0.03), (0.19, 0.24), TAILLIGHT),
    ]
    tall, x, floor = who.height_m, -0.1, 0.18
    hip, neck = (x, 0.0, 0.51 * tall + floor), (x, 0.0, 0.825 * tall + floor)
    helmet = paint(pick(rng, _HELMETS)) if rng.random() < 0.4 else None
    parts += _sitting(who, hip, neck, (0.35, 0.25, 1.1), helmet)
    for way in (1, -1):
        y, ankle = way * 0.05 * tall, (x + way * 0.11 - 0.03, way * 0.035, floor + 0.04 * tall)
        knee = (x + way * 0.07 + 0.05, y, floor + 0.27 * tall)
        parts.append(seated_leg(who, (x, y, hip[2] - 0.01), knee, ankle))
    return varied(rng, parts, 0.02)
