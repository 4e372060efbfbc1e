"""Pickups and vans."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, block, both, pick, rectangle, varied
from upvl_cli.synthetic.cars import PAINTS, WHITE, Form, car, lights, mirrors, rolling, tail
from upvl_cli.synthetic.mesh import Mesh, box, tube
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.surface import (
    CHROME,
    DARK,
    GLASS,
    PLATE,
    STEEL,
    TAILLIGHT,
    WOOD,
    Finish,
    Rgb,
    paint,
)

_VAN_PAINTS: tuple[Rgb, ...] = (WHITE, WHITE, (182, 186, 190), (206, 160, 30), (40, 70, 140), (150, 30, 34))

_PICKUP = Form(
    Shell(
        ((-0.6, 0.42), (2.55, 0.42), (2.68, 0.5), (2.7, 0.9), (2.64, 1.06), (2.4, 1.12), (1.4, 1.17))
        + ((-0.62, 1.17),),
        1.93,
        0.05,
    ),
    Shell(((-0.58, 1.1), (1.55, 1.1), (0.85, 1.76), (0.65, 1.82), (-0.35, 1.82), (-0.5, 1.77)), 1.78, 0.18),
    (1.22, 1.72),
    ((0.47, 0.93), (0.07, 0.42)),
    (-1.6, 1.75),
    0.39,
    (-0.52, 0.42, 1.3),
    (0.82, 1.02),
    (0.75, 1.05),
)


def _bed(lacquer: Finish) -> list[Mesh]:
    """Return the open bed of a pickup."""
    bed = Shell(rectangle((-2.68, -0.5), (0.45, 0.72)), 1.87)
    return [
        bed.mesh(lacquer),
        block((-2.6, -0.6), (-0.86, 0.86), (0.7, 0.74), DARK),
        both((-2.66, -0.52), (0.86, 0.925), (0.68, 1.14), lacquer),
        block((-2.7, -2.61), (-0.915, 0.915), (0.6, 1.13), lacquer),
        block((-0.7, -0.61), (-0.88, 0.88), (0.68, 1.12), lacquer),
        both((-2.715, -2.55), (0.78, 0.94), (0.76, 1.06), TAILLIGHT),
        block((-2.72, -2.6), (-0.26, 0.26), (0.66, 0.78), PLATE),
        block((-2.74, -2.5), (-0.9, 0.9), (0.44, 0.57), CHROME),
        both((-2.3, -0.9), (0.84, 0.95), (1.12, 1.16), DARK),
    ]


def pickup(rng: np.random.Generator) -> ObjectModel:
    """Return a car with an open bed at its rear, at times loaded."""
    lacquer = paint(pick(rng, PAINTS))
    form = _PICKUP
    parts = [*car(form, lacquer), *_bed(lacquer)]
    load = int(rng.integers(4))
    if load == 0:
        parts += [box((0.8, 0.6, 0.5), (-1.3 - 0.5 * n, 0.3 - 0.5 * n, 0.98), WOOD) for n in (0, 1)]
    elif load == 1:
        parts += [
            tube((-2.55, y, 1.2), (-0.6, y, 1.2), 0.05, STEEL, sides=6) for y in (-0.3, -0.18, 0.1, 0.3)
        ]
    elif load == 2:
        parts.append(block((-2.58, -0.62), (-0.85, 0.85), (1.0, 1.18), DARK))
    return varied(rng, parts)


_VAN = Shell(
    ((-2.68, 0.3), (2.6, 0.3), (2.73, 0.42), (2.75, 0.85), (2.62, 1.05), (2.15, 1.22), (1.4, 2.2))
    + ((1.1, 2.38), (0.8, 2.4), (-2.6, 2.4), (-2.72, 2.3), (-2.75, 0.6)),
    2.0,
    0.14,
)


def _van(lacquer: Finish, glazed: bool) -> list[Mesh]:
    """Return a van, with windows along the sides or closed."""
    body = _VAN
    form = Form(
        body, body, (1.3, 2.1), (), (-1.65, 1.85), 0.35, (-0.75, 0.35, 1.35), (0.82, 1.04), (0.9, 1.4)
    )
    door = ((0.5, 1.3), (2.0, 1.3), (1.9, 1.5), (1.45, 2.0), (0.5, 2.0))
    parts = [body.mesh(lacquer), *lights(form), *tail(form), *rolling(form)]
    parts.append(body.screen((1.3, 2.12), GLASS))
    parts.append(body.side(door, GLASS))
    parts += [body.badge((y - 0.36, y + 0.36), (1.4, 2.05), GLASS, way=-1) for y in (-0.42, 0.42)]
    parts += [body.side(rectangle((x - 0.01, x + 0.01), (0.45, 2.15)), DARK, 0.014) for x in (0.4, -0.95)]
    parts.append(body.side(rectangle((-1.15, 1.3), (0.5, 0.6)), DARK, 0.02))
    parts += [mirrors(1.75, body.half_m(1.35), 1.35, DARK), mirrors(1.75, body.half_m(1.5), 1.5, DARK)]
    if glazed:
        parts += [body.side(rectangle(span, (1.35, 2.0)), GLASS) for span in ((-0.8, 0.3), (-2.4, -1.05))]
    return parts


def van(rng: np.random.Generator) -> ObjectModel:
    """Return a van for goods or people."""
    parts = _van(paint(pick(rng, _VAN_PAINTS)), bool(rng.random() < 0.35))
    livery = paint(pick(rng, PAINTS))
    if rng.random() < 0.3:
        parts.append(_VAN.side(rectangle((-2.3, 0.2), (1.05, 1.25)), livery))
    if rng.random() < 0.25:
        parts += [block((x - 0.04, x + 0.04), (-0.8, 0.8), (2.39, 2.47), STEEL) for x in (-2.0, -0.8, 0.4)]
        parts.append(both((-2.4, 0.9), (0.3, 0.36), (2.475, 2.53), STEEL))
    return varied(rng, parts, 0.05)
