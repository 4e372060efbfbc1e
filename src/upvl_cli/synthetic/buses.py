"""What carries many: buses, school buses and trams."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, arches, block, both, pick, rectangle, varied, wheels
from upvl_cli.synthetic.cars import AMBER_LIGHT, RED_LIGHT, WHITE
from upvl_cli.synthetic.mesh import Mesh, Pair, tube
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
    (200, 24, 30),
    (226, 186, 40),
    (36, 84, 170),
    (44, 128, 72),
    WHITE,
    (222, 110, 30),
    (150, 196, 220),
)


def _panes(shell: Shell, x_m: Pair, z_m: Pair, count: int) -> list[Mesh]:
    """Windows in a row on both sides."""
    edges = np.linspace(*x_m, count + 1)
    return [
        shell.side(rectangle((float(a) + 0.04, float(b) - 0.04), z_m), GLASS)
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]


def _door(x_m: Pair, y_m: float, z_m: Pair) -> list[Mesh]:
    """Return a door of two glass wings on the right side."""
    middle = (x_m[0] + x_m[1]) / 2
    inner = -(y_m - 0.05)
    return [
        block(x_m, (-(y_m + 0.012), inner), z_m, DARK),
        block((x_m[0] + 0.06, middle - 0.03), (-(y_m + 0.022), inner), (z_m[0] + 0.15, z_m[1] - 0.1), GLASS),
        block((middle + 0.03, x_m[1] - 0.06), (-(y_m + 0.022), inner), (z_m[0] + 0.15, z_m[1] - 0.1), GLASS),
    ]


def _bus(lacquer: Finish, skirt: Finish, height_m: float) -> tuple[Shell, list[Mesh]]:
    body = Shell(
        ((-5.95, 0.32), (5.9, 0.32), (6.0, 0.5), (6.0, 1.05), (5.9, height_m - 0.3), (5.75, height_m))
        + ((-5.85, height_m), (-5.98, height_m - 0.15), (-6.0, 0.6)),
        2.55,
    )
    parts = [body.mesh(lacquer), body.side(rectangle((-5.9, 5.85), (0.36, 0.95)), skirt)]
    parts += [arches((-3.0, 3.3), 1.29, 0.48), wheels((-3.0, 3.3), 1.31, 0.48, 0.35, STEEL, 0.5)]
    parts += [*_panes(body, (-5.8, 5.7), (1.3, 2.4), 8), body.screen((1.15, 2.4), GLASS, margin_m=0.06)]
    parts += [body.lamps(0.35, (0.62, 0.82), HEADLIGHT), body.badge((-0.26, 0.26), (0.55, 0.67), PLATE)]
    parts += [
        body.lamps(0.14, (0.8, 1.5), TAILLIGHT, way=-1),
        body.badge((-0.9, 0.9), (1.6, 2.4), GLASS, way=-1),
    ]
    parts += [
        body.badge((-0.26, 0.26), (0.6, 0.72), PLATE, way=-1),
        body.screen((0.85, 1.05), DARK, way=-1, margin_m=0.4),
    ]
    for x in (4.6, -0.6):
        parts += _door((x - 0.6, x + 0.6), 1.285, (0.4, 2.44))
    parts.append(both((5.8, 6.15), (1.3, 1.5), (1.9, 2.3), DARK))
    return body, parts


def bus(rng: np.random.Generator) -> ObjectModel:
    """Return a city bus with two doors and a sign that says where it goes."""
    lacquer = paint(pick(rng, _PAINTS))
    body, parts = _bus(lacquer, paint(pick(rng, (*_PAINTS, (60, 62, 66)))), 3.05)
    parts += [
        body.screen((2.5, 2.75), DARK, margin_m=0.3),
        body.badge((-0.6, 0.7), (2.54, 2.7), AMBER_LIGHT, lift_m=0.03),
    ]
    parts.append(block((-1.5, 1.2), (-0.8, 0.8), (3.0, 3.28 if rng.random() < 0.6 else 3.15), lacquer))
    return varied(rng, parts, 0.03)


def double_decker(rng: np.random.Generator) -> ObjectModel:
    """Return a bus of two floors, mostly red."""
    lacquer = paint(pick(rng, (_PAINTS[0], _PAINTS[0], *_PAINTS[:4])))
    body, parts = _bus(lacquer, lacquer, 4.35)
    parts += [*_panes(body, (-5.7, 5.6), (2.95, 3.85), 8), body.screen((2.95, 3.9), GLASS, margin_m=0.08)]
    parts.append(body.badge((-1.0, 1.0), (2.95, 3.8), GLASS, way=-1))
    parts += [
        body.screen((2.5, 2.85), DARK, margin_m=0.4),
        body.badge((-0.6, 0.6), (2.56, 2.78), AMBER_LIGHT, lift_m=0.03),
    ]
    if rng.random() < 0.6:
        advert = paint(pick(rng, (WHITE, (250, 220, 60), (30, 130, 180))))
        parts.append(body.side(rectangle((-4.5, 2.5), (2.5, 2.86)), advert))
    return varied(rng, parts, 0.02)


def school_bus(rng: np.random.Generator) -> ObjectModel:
    """Return a yellow bus with a bonnet and black stripes."""
    yellow = paint(pick(rng, ((246, 184, 16), (250, 170, 10), (240, 190, 40))))
    body = Shell(
        ((-5.2, 0.6), (3.5, 0.6), (3.6, 1.6), (3.4, 2.7), (3.2, 2.95), (2.9, 3.05), (-4.9, 3.05))
        + ((-5.15, 2.9), (-5.25, 2.5)),
        2.4,
        0.03,
    )
    bonnet = Shell(((3.3, 0.6), (5.0, 0.6), (5.1, 0.75), (5.05, 1.35), (4.9, 1.45), (3.3, 1.65)), 2.0, 0.2)
    parts = [body.mesh(yellow), bonnet.mesh(yellow), *_panes(body, (-4.9, 2.5), (1.75, 2.45), 9)]
    parts += [body.side(rectangle((-5.15, 3.45), (z, z + 0.09)), DARK, 0.02) for z in (0.85, 1.2, 1.55)]
    parts += [body.screen((1.75, 2.55), GLASS), body.side(rectangle((2.6, 3.3), (1.75, 2.4)), GLASS)]
    parts += [
        body.badge((-0.9, 0.9), (1.75, 2.45), GLASS, way=-1),
        body.lamps(0.3, (1.25, 1.5), TAILLIGHT, way=-1),
    ]
    parts += [bonnet.badge((-0.55, 0.55), (0.85, 1.3), DARK), bonnet.lamps(0.28, (1.0, 1.25), HEADLIGHT)]
    parts += [
        block((4.9, 5.25), (-1.12, 1.12), (0.45, 0.75), DARK),
        block((-5.4, -5.1), (-1.15, 1.15), (0.5, 0.75), DARK),
    ]
    parts += [
        block((5.2, 5.27), (-0.2, 0.2), (0.54, 0.66), PLATE),
        block((-5.43, -5.3), (-0.2, 0.2), (0.56, 0.68), PLATE),
    ]
    for way in (1, -1):
        parts += [
            body.badge((y - 0.12, y + 0.12), (2.72, 2.9), RED_LIGHT, way=way, lift_m=0.06)
            for y in (-0.9, 0.9)
        ]
        parts += [
            body.badge((y - 0.12, y + 0.12), (2.72, 2.9), AMBER_LIGHT, way=way, lift_m=0.06)
            for y in (-0.6, 0.6)
        ]
    parts += [arches((-2.9,), 1.2, 0.48), arches((4.2,), 0.98, 0.48)]
    parts += [wheels((-2.9,), 1.235, 0.48, 0.4, CHROME, 0.5), wheels((4.2,), 1.02, 0.48, 0.3, CHROME, 0.5)]
    parts += [*_door((2.5, 3.2), 1.205, (0.65, 2.5)), both((3.7, 3.8), (1.2, 1.42), (1.7, 2.15), DARK)]
    parts += [
        tube((1.9, 1.1, 1.45), (1.9, 1.28, 1.45), 0.25, RED_LIGHT, sides=8),
        block((-1.5, -0.9), (-0.3, 0.3), (3.02, 3.16), yellow),
    ]
    return varied(rng, parts, 0.04)


def tram(rng: np.random.Generator) -> ObjectModel:
    """Return a tram of three low cars, with bellows between them and a pantograph on top."""
    lacquer = paint(pick(rng, (*_PAINTS, (196, 40, 44), (240, 214, 120))))
    roof = Finish((150, 154, 158), 0.4)
    front = Shell(
        ((4.4, 0.18), (12.1, 0.18), (12.4, 0.5), (12.4, 1.15), (11.75, 2.75), (11.4, 3.05), (4.4, 3.05)),
        2.5,
        0.06,
    )
    middle = Shell(rectangle((-3.8, 3.8), (0.18, 3.05)), 2.5, 0.06)
    parts: list[Mesh] = []
    for way in (1, -1):
        parts += [
            piece if way == 1 else piece.moved((0.0, 0.0, 0.0), np.pi)
            for piece in (
                front.mesh(lacquer),
                front.screen((1.22, 2.65), GLASS, margin_m=0.1),
                front.side(rectangle((10.7, 11.6), (1.3, 2.3)), GLASS),
                *_panes(front, (4.5, 10.6), (1.15, 2.45), 4),
                front.side(rectangle((4.45, 11.9), (0.22, 0.55)), DARK),
                front.lamps(0.3, (0.7, 0.9), HEADLIGHT if way == 1 else TAILLIGHT),
                front.screen((0.2, 0.45), DARK, margin_m=0.1),
                *_door((8.2, 9.5), 1.25, (0.3, 2.5)),
                block((3.7, 4.5), (-1.1, 1.1), (0.35, 2.95), DARK),
                block((5.2, 9.8), (-0.85, 0.85), (3.0, 3.35), roof),
                wheels((6.1, 7.6), 0.9, 0.3, 0.2, STEEL, 0.8),
            )
        ]
    parts.append(front.badge((-0.5, 0.5), (2.77, 2.95), AMBER_LIGHT))
    parts += [middle.mesh(lacquer), *_panes(middle, (-3.7, 3.7), (1.15, 2.45), 5)]
    parts += [middle.side(rectangle((-3.75, 3.75), (0.22, 0.55)), DARK)]
    for x in (-1.9, 1.9):
        parts += _door((x - 0.65, x + 0.65), 1.25, (0.3, 2.5))
    stripe = paint(pick(rng, (WHITE, (60, 62, 66))))
    if stripe != lacquer:
        parts += [
            shell.side(rectangle(x, (2.6, 2.85)), stripe)
            for shell, x in ((middle, (-3.7, 3.7)), (front, (4.5, 11.2)))
        ]
        parts.append(front.side(rectangle((4.5, 11.2), (2.6, 2.85)), stripe).moved((0.0, 0.0, 0.0), np.pi))
    parts += [block((-2.9, -1.2), (-0.7, 0.7), (3.0, 3.3), roof), *_pantograph()]
    return varied(rng, parts, 0.03)


def _pantograph() -> list[Mesh]:
    """Arms that reach for the wire."""
    arms = [
        tube(start, end, 0.035, STEEL, sides=5)
        for y in (-0.35, 0.35)
        for start, end in (((0.4, y, 3.05), (1.9, y, 3.45)), ((1.9, y, 3.45), (0.9, y * 0.6, 3.85)))
    ]
    return [
        *arms,
        block((0.82, 0.98), (-0.8, 0.8), (3.84, 3.9), DARK),
        block((0.2, 2.1), (-0.5, 0.5), (3.02, 3.12), DARK),
    ]
