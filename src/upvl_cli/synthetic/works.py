"""Vehicles at work: fire trucks, farm tractors and mobile cranes."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, arches, block, both, pick, rectangle, varied, wheels
from upvl_cli.synthetic.cars import AMBER_LIGHT, BLUE_LIGHT, WHITE
from upvl_cli.synthetic.mesh import box, prism, tube
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.surface import (
    CHROME,
    DARK,
    GLASS,
    HEADLIGHT,
    RUBBER,
    STEEL,
    TAILLIGHT,
    Finish,
    paint,
)
from upvl_cli.synthetic.trucks import SHUTTER, YELLOW, cab, frame, tail


def fire_truck(rng: np.random.Generator) -> ObjectModel:
    """Return a red lorry with silver shutters, a ladder on its roof and blue lights."""
    red = paint(pick(rng, ((206, 20, 24), (220, 34, 20), (180, 16, 24))))
    white = paint(WHITE)
    parts = [*cab(4.2, 2.9, (0.5, 2.8), red, (3.0,), width_m=2.46), frame((-4.0, 4.0), 0.9)]
    body = Shell(rectangle((-4.2, 1.2), (0.6, 2.95)), 2.5)
    parts += [body.mesh(red), *tail(-4.18, 1.2, 0.85)]
    parts.append(arches((-2.4,), 1.25, 0.5))
    parts.append(wheels((-2.4,), 1.27, 0.5, 0.35, STEEL, 0.5))
    for x in (-4.05, -1.7, -0.2):
        parts.append(body.side(rectangle((x, x + 1.3 - 0.2 * (x < -4)), (1.25, 2.65)), SHUTTER, 0.012))
    parts.append(body.side(rectangle((-4.15, 1.15), (1.07, 1.2)), white))
    parts.append(both((1.35, 4.0), (1.2, 1.245), (1.2, 1.34), white))
    parts.append(both((1.45, 2.1), (1.1, 1.215), (1.85, 2.45), GLASS))
    parts.append(body.badge((-0.8, 0.8), (1.2, 2.7), SHUTTER, way=-1))
    ladder = [both((-4.3, 3.6), (0.24, 0.31), (3.06, 3.2), STEEL)]
    ladder += [block((x, x + 0.05), (-0.25, 0.25), (3.1, 3.16), STEEL) for x in np.arange(-4.1, 3.5, 0.4)]
    parts += [
        *ladder,
        block((1.4, 1.6), (-0.5, 0.5), (2.7, 3.08), DARK),
        tube((-3, 0, 2.9), (-3, 0, 3.1), 0.4, DARK),
    ]
    parts.append(both((3.2, 3.5), (0.35, 1.05), (2.75, 3.02), BLUE_LIGHT))
    parts.append(both((-4.1, -3.85), (0.9, 1.15), (2.9, 3.12), BLUE_LIGHT))
    return varied(rng, parts, 0.03)


def tractor(rng: np.random.Generator) -> ObjectModel:
    """Return a farm tractor: big rear wheels, small front wheels, a narrow bonnet."""
    lacquer = paint(pick(rng, ((44, 122, 46), (194, 30, 30), (36, 84, 168), (226, 116, 26))))
    rim = paint(pick(rng, ((240, 206, 40), (226, 226, 220), (194, 30, 30))))
    bonnet = Shell(
        ((-0.2, 0.75), (1.95, 0.75), (2.0, 0.9), (1.95, 1.4), (1.8, 1.5), (-0.2, 1.62)), 0.74, 0.06
    )
    cab = Shell(
        ((-1.55, 1.15), (-0.1, 1.15), (0.05, 1.6), (-0.25, 2.55), (-1.5, 2.55), (-1.65, 1.6)), 1.3, 0.1
    )
    parts = [bonnet.mesh(lacquer), cab.mesh(DARK), cab.screen((1.66, 2.45), GLASS, margin_m=0.06)]
    parts += [
        cab.screen((1.66, 2.45), GLASS, way=-1, margin_m=0.06),
        cab.window((0.56, 0.95), (1.64, 2.45), GLASS),
    ]
    parts += [
        cab.window((0.06, 0.5), (1.64, 2.45), GLASS),
        block((-1.7, 0.0), (-0.66, 0.66), (2.53, 2.7), lacquer),
    ]
    parts += [bonnet.lamps(0.16, (1.15, 1.32), HEADLIGHT), bonnet.badge((-0.25, 0.25), (0.85, 1.1), DARK)]
    parts += [bonnet.side(rectangle((0.3, 1.6), (1.05, 1.3)), DARK), frame((-1.4, 1.7), 0.85)]
    parts += [wheels((-0.95,), 1.0, 0.82, 0.48, rim, 0.58), wheels((1.4,), 0.9, 0.55, 0.36, rim, 0.55)]
    fender = ((-1.75, 1.5), (-0.15, 1.5), (-0.3, 1.74), (-1.55, 1.76))
    parts += [prism(fender, 0.38, lacquer).moved((0.0, y, 0.0)) for y in (-0.8, 0.8)]
    parts += [tube((0.5, 0.3, 1.4), (0.5, 0.3, 2.5), 0.05, STEEL, sides=8)]
    parts += [
        both((-1.8, -1.7), (0.7, 0.95), (1.56, 1.7), TAILLIGHT),
        both((-0.5, 0.5), (0.4, 0.75), (0.6, 0.66), DARK),
    ]
    if rng.random() < 0.6:
        parts.append(block((-0.95, -0.8), (0.4, 0.52), (2.69, 2.83), AMBER_LIGHT))
    return varied(rng, parts, 0.06)


def crane(rng: np.random.Generator) -> ObjectModel:
    """Return a mobile crane: a long low carrier, and a boom that lies forward."""
    yellow = paint(pick(rng, (YELLOW, YELLOW, (236, 130, 24), (204, 40, 36))))
    grey = Finish((92, 96, 100), 0.3)
    carrier = Shell(rectangle((-5.4, 4.2), (0.85, 1.5)), 2.5)
    parts = [carrier.mesh(yellow), *cab(5.9, 1.75, (0.6, 2.3), yellow, width_m=2.5), *tail(-5.4, 1.15, 1.1)]
    parts.append(wheels((-4.2, -2.6, 1.6, 3.2), 1.27, 0.6, 0.42, STEEL, 0.5))
    for x in (-5.2, -0.7):
        parts.append(both((x, x + 0.35), (0.9, 1.285), (0.5, 1.6), DARK))
        parts.append(carrier.side(rectangle((x + 0.6, x + 1.4), (1.25, 1.42)), AMBER_LIGHT))
    parts.append(tube((-2.0, 0.0, 1.4), (-2.0, 0.0, 1.75), 0.9, grey, sides=14))
    parts.append(block((-5.0, -0.6), (-0.75, 0.75), (1.7, 2.2), yellow))
    parts.append(block((-5.6, -4.3), (-1.2, 1.2), (1.6, 2.7), grey))
    cabin = Shell(((-1.0, 1.65), (0.6, 1.65), (0.75, 1.9), (0.45, 3.0), (-0.9, 3.0)), 0.85, 0.06)
    parts += [
        piece.moved((0.0, 0.8, 0.0))
        for piece in (
            cabin.mesh(yellow),
            cabin.screen((2.0, 2.9), GLASS, margin_m=0.06),
            cabin.window((0.1, 0.92), (2.1, 2.9), GLASS),
        )
    ]
    slope = 0.035 + float(rng.uniform(0.0, 0.03))
    for n, (start, end) in enumerate(((-3.9, 4.2), (4.0, 5.3), (5.1, 6.3))):
        size = 0.72 - 0.13 * n
        boom = box((end - start, size * 0.85, size), ((start + end) / 2, -0.25, 2.75), yellow)
        parts.append(boom.tilted(-slope, (-3.9, 0.0, 2.75)))
    tip = 2.75 + 10.2 * slope
    parts.append(block((6.2, 6.5), (-0.5, 0.0), (tip - 0.45, tip + 0.3), grey))
    parts.append(tube((6.4, -0.25, tip - 0.4), (6.4, -0.25, 1.6), 0.02, DARK, sides=4))
    parts.append(block((6.3, 6.5), (-0.35, -0.15), (1.2, 1.65), RUBBER))
    parts.append(tube((-1.2, -0.25, 1.8), (1.6, -0.25, 2.7), 0.14, CHROME, sides=8))
    return varied(rng, parts, 0.03)
