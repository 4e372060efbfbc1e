"""Lorries: box, articulated and garbage trucks, tippers, concrete mixers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, arches, block, both, pick, rectangle, varied, wheels
from upvl_cli.synthetic.cars import AMBER_LIGHT, WHITE
from upvl_cli.synthetic.mesh import Mesh, Pair, prism, tube
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.surface import (
    CHROME,
    DARK,
    GLASS,
    HEADLIGHT,
    PLATE,
    STEEL,
    TAILLIGHT,
    Finish,
    Rgb,
    paint,
)

_PAINTS: tuple[Rgb, ...] = (
    WHITE,
    WHITE,
    (196, 30, 34),
    (32, 74, 156),
    (236, 176, 30),
    (40, 108, 70),
    (60, 64, 70),
    (226, 112, 30),
)
YELLOW: Rgb = (244, 182, 20)
SHUTTER = Finish((176, 180, 184), 0.6, texture="plain", gloss=0.3)


def cab(
    front_m: float,
    length_m: float,
    z_m: Pair,
    lacquer: Finish,
    axles_m: Sequence[float] = (),
    *,
    width_m: float = 2.45,
    radius_m: float = 0.5,
) -> list[Mesh]:
    """Return a cab over its engine, flat in front, and the front axles."""
    low, high = z_m
    back, belt = front_m - length_m, low + 0.52 * (high - low)
    shell = Shell(
        ((back, low), (front_m - 0.04, low), (front_m, low + 0.12), (front_m, belt))
        + ((front_m - 0.2, high - 0.22), (front_m - 0.4, high), (back, high)),
        width_m,
        0.08,
    )
    glass, half = (belt + 0.04, high - 0.26), shell.half_m(belt)
    door = ((back + 0.5 * length_m - 0.35, glass[0]), (front_m - 0.15, glass[0] - 0.06))
    parts = [shell.mesh(lacquer), shell.screen(glass, GLASS, margin_m=0.1)]
    parts.append(shell.side((*door, (front_m - 0.32, glass[1]), (door[0][0], glass[1])), GLASS))
    parts.append(shell.side(rectangle((door[0][0] - 0.1, door[0][0] - 0.08), (low + 0.3, high - 0.2)), DARK))
    parts.append(shell.badge((-0.7, 0.7), (low + 0.5, belt - 0.12), DARK))
    parts.append(shell.screen((low + 0.13, low + 0.38), DARK, margin_m=0.02))
    parts.append(shell.lamps(0.4, (low + 0.4, low + 0.6), HEADLIGHT))
    parts.append(shell.badge((-0.26, 0.26), (low + 0.18, low + 0.3), PLATE, lift_m=0.03))
    parts.append(
        both((front_m - 0.1, front_m + 0.06), (half + 0.02, half + 0.24), (glass[0] + 0.1, high - 0.3), DARK)
    )
    if not axles_m:
        return parts
    parts.append(arches(axles_m, width_m / 2, radius_m))
    return [*parts, wheels(axles_m, width_m / 2 + 0.03, radius_m, 0.35, STEEL, 0.5)]


def tail(rear_m: float, half_m: float, z_m: float) -> list[Mesh]:
    """Lights, plate and bumper at the rear."""
    return [
        block((rear_m - 0.03, rear_m + 0.1), (-half_m, half_m), (z_m - 0.22, z_m), STEEL),
        both(
            (rear_m - 0.05, rear_m + 0.05),
            (half_m - 0.45, half_m - 0.03),
            (z_m - 0.18, z_m - 0.04),
            TAILLIGHT,
        ),
        block((rear_m - 0.05, rear_m), (-0.26, 0.26), (z_m - 0.17, z_m - 0.05), PLATE),
    ]


def frame(x_m: Pair, top_m: float) -> Mesh:
    """Return the girders below."""
    return block(x_m, (-0.45, 0.45), (top_m - 0.35, top_m), DARK)


def box_truck(rng: np.random.Generator) -> ObjectModel:
    """Return a lorry with a box, at times with a stripe or a picture on it."""
    load = paint(pick(rng, _PAINTS))
    parts = [
        *cab(3.7, 1.75, (0.5, 2.75), paint(pick(rng, _PAINTS)), (2.75,), radius_m=0.47),
        frame((-3.5, 3.4), 0.95),
    ]
    parts.append(wheels((-1.9,), 1.22, 0.47, 0.3, STEEL, 0.5))
    parts.append(both((-0.4, 0.9), (0.6, 1.1), (0.45, 0.9), STEEL))
    body = Shell(rectangle((-3.75, 1.8), (0.98, 3.45)), 2.5)
    parts += [body.mesh(load), *tail(-3.72, 1.2, 0.9)]
    parts += [body.side(rectangle((-3.73, 1.78), span), STEEL, 0.02) for span in ((1.0, 1.1), (3.36, 3.43))]
    parts += [body.badge((y - 0.55, y + 0.55), (1.15, 3.3), SHUTTER, way=-1) for y in (-0.58, 0.58)]
    logo = paint(pick(rng, _PAINTS))
    if logo != load:
        parts.append(body.side(rectangle((-3.0, 1.0), pick(rng, ((1.5, 1.9), (1.8, 2.8)))), logo))
    if rng.random() < 0.5:
        parts.append(block((2.0, 2.9), (-0.9, 0.9), (2.7, 3.2), load))
    return varied(rng, parts, 0.06)


def _bonneted(lacquer: Finish) -> list[Mesh]:
    """Return a cab behind a bonnet, with upright exhausts."""
    bonnet = Shell(((6.1, 0.7), (8.0, 0.7), (8.1, 0.85), (8.05, 1.7), (7.9, 1.8), (6.1, 1.95)), 1.8, 0.15)
    cab = Shell(((4.3, 0.7), (6.2, 0.7), (6.2, 1.9), (5.95, 2.8), (5.7, 3.0), (4.3, 3.4)), 2.3, 0.12)
    parts = [bonnet.mesh(lacquer), cab.mesh(lacquer), bonnet.badge((-0.45, 0.45), (0.95, 1.65), CHROME)]
    parts += [cab.screen((2.0, 2.7), GLASS), cab.side(rectangle((5.1, 5.85), (1.95, 2.65)), GLASS)]
    parts += [
        block((7.9, 8.25), (-1.15, 1.15), (0.5, 0.85), CHROME),
        bonnet.lamps(0.3, (1.0, 1.2), HEADLIGHT),
    ]
    parts += [arches((7.2,), 1.15, 0.5, lacquer), both((4.6, 6.0), (0.7, 1.2), (0.5, 0.95), CHROME)]
    for y in (-1.2, 1.2):
        parts.append(tube((4.45, y, 0.9), (4.45, y, 3.7), 0.08, CHROME, sides=8))
    parts.append(both((6.0, 6.1), (1.15, 1.4), (2.0, 2.6), DARK))
    return parts


def _trailer(rng: np.random.Generator, lacquer: Finish) -> list[Mesh]:
    """Return what is pulled: a box, a container or a tank, of one length."""
    form = int(rng.integers(4))
    if form == 0:
        tank = SHUTTER if rng.random() < 0.6 else lacquer
        parts = [tube((-7.9, 0.0, 2.5), (4.0, 0.0, 2.5), 1.2, tank, sides=18)]
        parts += [tube((x, 0, 2.5), (x + 0.1, 0, 2.5), 1.22, DARK, sides=18) for x in (-6.5, -4.0, -1.5, 1.5)]
        return [*parts, block((-7.0, 3.0), (-0.25, 0.25), (3.66, 3.8), STEEL), frame((-7.8, 3.9), 1.4)]
    body = Shell(rectangle((-8.1, 4.15), (1.2, 3.95)), 2.55)
    parts = [body.mesh(lacquer)]
    parts += [body.badge((y - 0.57, y + 0.57), (1.3, 3.85), SHUTTER, way=-1) for y in (-0.6, 0.6)]
    if form == 1:
        shade = paint((lacquer.rgb[0] * 3 // 4, lacquer.rgb[1] * 3 // 4, lacquer.rgb[2] * 3 // 4))
        parts += [
            body.side(rectangle((float(x), float(x) + 0.22), (1.4, 3.8)), shade, 0.02)
            for x in np.arange(-7.9, 4.0, 0.6)
        ]
    else:
        parts.append(body.side(rectangle((-8.08, 4.13), (1.22, 1.36)), STEEL, 0.012))
        parts.append(body.side(rectangle((-6.5, 2.5), (1.9, 3.1)), paint(pick(rng, _PAINTS)), 0.012))
    return [*parts, both((-3.6, 1.6), (1.15, 1.2), (0.6, 1.1), STEEL)]


def articulated_truck(rng: np.random.Generator) -> ObjectModel:
    """Return a tractor unit and its long trailer."""
    lacquer = paint(pick(rng, _PAINTS))
    american = rng.random() < 0.35
    if american:
        parts = [*_bonneted(lacquer), wheels((7.2,), 1.2, 0.5, 0.3, CHROME, 0.5), frame((2.3, 8.0), 0.95)]
    else:
        parts = cab(7.0, 2.2, (0.55, 3.5), lacquer, (5.6,), width_m=2.5)
        deflector = Shell(((4.8, 3.4), (6.5, 3.4), (6.3, 3.6), (5.0, 3.95), (4.8, 3.95)), 2.3, 0.15)
        parts += [deflector.mesh(lacquer), block((6.55, 7.1), (-1.0, 1.0), (3.28, 3.36), DARK)]
        parts += [frame((2.3, 6.5), 0.95)]
        parts.append(both((3.9, 5.0), (0.6, 1.15), (0.45, 0.95), STEEL))
    trailer = paint(pick(rng, ((222, 224, 224), *_PAINTS)))
    parts += _trailer(rng, trailer)
    parts.append(wheels((2.8, *((4.1,) if american else ())), 1.25, 0.5, 0.5, STEEL, 0.5))
    parts += [wheels((-6.9, -5.6, -4.3), 1.25, 0.5, 0.4, STEEL, 0.5), frame((-8.0, 4.0), 1.23)]
    parts += [both((0.9, 1.05), (0.75, 0.9), (0.35, 1.0), STEEL), *tail(-8.08, 1.22, 1.0)]
    return varied(rng, parts, 0.03)


def tipper(rng: np.random.Generator) -> ObjectModel:
    """Return a lorry with an open skip for sand and stones."""
    lacquer = paint(pick(rng, (YELLOW, *_PAINTS)))
    skip = paint(pick(rng, ((226, 112, 30), (96, 100, 104), YELLOW, (60, 110, 60))))
    parts = [*cab(4.1, 1.7, (0.6, 2.95), lacquer, (3.2,), radius_m=0.52), frame((-3.9, 3.8), 1.1)]
    parts.append(wheels((-2.6, -1.25), 1.24, 0.52, 0.4, STEEL, 0.5))
    body = Shell(((-3.6, 1.15), (2.0, 1.15), (2.15, 2.6), (-4.15, 2.45)), 2.4, -0.06)
    parts += [body.mesh(skip), *tail(-3.95, 1.2, 1.05)]
    parts.append(Shell(((2.0, 2.4), (3.1, 3.0), (3.1, 3.1), (2.0, 2.7)), 2.4).mesh(skip))
    for x in (-3.0, -2.1, -1.2, -0.3, 0.6, 1.5):
        parts.append(both((x - 0.06, x + 0.06), (1.2, 1.3), (1.2, 2.5), skip))
    sand = Finish(pick(rng, ((190, 160, 110), (120, 114, 106), (88, 66, 48))), 0.35)
    heap = ((-3.8, 2.4), (1.9, 2.4), (0.8, 2.8), (-0.8, 3.0), (-2.6, 2.75))
    parts.append(prism(heap, 2.2, sand, 0.8))
    return varied(rng, parts, 0.04)


def concrete_mixer(rng: np.random.Generator) -> ObjectModel:
    """Return a lorry with a turning drum."""
    parts = [*cab(4.2, 1.7, (0.6, 2.95), paint(pick(rng, _PAINTS)), (3.2,)), frame((-4.0, 3.9), 1.1)]
    parts.append(wheels((-2.8, -1.45, 1.9), 1.24, 0.5, 0.35, STEEL, 0.5))
    drum, band = paint(pick(rng, (WHITE, (190, 192, 190), (236, 120, 30)))), paint(pick(rng, _PAINTS[2:]))
    for start, end, radius, last, surface in (
        ((2.2, 1.9), (1.2, 2.05), 0.7, 1.18, drum),
        ((1.2, 2.05), (0.5, 2.15), 1.18, 1.22, band),
        ((0.5, 2.15), (-0.8, 2.35), 1.22, 1.1, drum),
        ((-0.8, 2.35), (-1.3, 2.43), 1.1, 0.98, band),
        ((-1.3, 2.43), (-3.3, 2.75), 0.98, 0.5, drum),
    ):
        parts.append(
            tube((start[0], 0, start[1]), (end[0], 0, end[1]), radius, surface, end_radius_m=last, sides=16)
        )
    parts += [
        both((2.1, 2.3), (0.2, 0.9), (1.05, 2.2), STEEL),
        both((-3.1, -2.9), (0.5, 0.7), (1.0, 2.6), STEEL),
    ]
    parts.append(tube((-3.4, 0.0, 3.5), (-3.4, 0.0, 2.7), 0.5, STEEL, end_radius_m=0.25))
    parts.append(tube((-3.6, 0.0, 2.1), (-4.5, 0.0, 1.2), 0.2, STEEL, sides=8))
    parts += tail(-4.0, 1.15, 1.05)
    return varied(rng, parts, 0.04)


def garbage_truck(rng: np.random.Generator) -> ObjectModel:
    """Return a lorry that presses rubbish, with an opening at its rear."""
    lacquer = paint(pick(rng, ((240, 128, 20), WHITE, (60, 130, 60))))
    load = paint(pick(rng, ((240, 128, 20), (60, 130, 60), (228, 230, 226))))
    parts = [*cab(4.2, 1.8, (0.5, 2.85), lacquer, (3.1,)), frame((-3.6, 4.0), 1.0)]
    parts.append(wheels((-2.5, -1.2), 1.24, 0.5, 0.35, STEEL, 0.5))
    body = Shell(((-2.4, 1.05), (2.2, 1.05), (2.2, 3.1), (1.9, 3.3), (-2.4, 3.3)), 2.45, 0.03)
    rear = Shell(((-3.9, 1.2), (-2.3, 0.7), (-2.3, 3.38), (-3.1, 3.38), (-4.0, 2.3), (-4.2, 1.5)), 2.5, 0.03)
    parts += [body.mesh(load), rear.mesh(load), *tail(-3.6, 1.1, 0.85)]
    parts += [rear.side(((-3.8, 1.4), (-2.6, 1.1), (-2.6, 1.3), (-3.8, 1.6)), AMBER_LIGHT)]
    parts += [
        rear.badge((-0.95, 0.95), (1.35, 2.2), DARK, way=-1),
        rear.lamps(0.2, (2.4, 2.7), TAILLIGHT, way=-1),
    ]
    parts += [body.side(rectangle((x, x + 0.1), (1.1, 3.15)), STEEL, 0.03) for x in (-1.6, -0.4, 0.8, 1.9)]
    parts.append(both((3.3, 3.5), (0.5, 0.7), (2.83, 3.0), AMBER_LIGHT))
    return varied(rng, parts, 0.03)
