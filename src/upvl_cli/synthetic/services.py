"""Cars in service: taxis, police cars and ambulances."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, arches, block, both, pick, rectangle, varied, wheels
from upvl_cli.synthetic.cars import BLUE_LIGHT, RED_LIGHT, SEDAN, SUV, WHITE, car, mirrors, tail
from upvl_cli.synthetic.mesh import Mesh
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.surface import DARK, GLASS, HEADLIGHT, PLATE, TAILLIGHT, Finish, paint


def _light_bar(x_m: float, top_m: float, half_m: float, right: Finish, left: Finish) -> list[Mesh]:
    return [
        block((x_m - 0.12, x_m + 0.12), (-half_m, half_m), (top_m - 0.03, top_m + 0.05), DARK),
        block((x_m - 0.15, x_m + 0.15), (-half_m - 0.02, -0.1), (top_m + 0.04, top_m + 0.17), right),
        block((x_m - 0.15, x_m + 0.15), (0.1, half_m + 0.02), (top_m + 0.04, top_m + 0.17), left),
        block((x_m - 0.13, x_m + 0.13), (-0.11, 0.11), (top_m + 0.045, top_m + 0.15), HEADLIGHT),
    ]


def police_car(rng: np.random.Generator) -> ObjectModel:
    """Return a saloon in police colours with a light bar: white and blue, or black and white."""
    blue = rng.random() < 0.6
    lacquer, door = (paint(WHITE), paint((20, 66, 178))) if blue else (paint((22, 23, 26)), paint(WHITE))
    parts = [*car(SEDAN, lacquer), *tail(SEDAN)]
    door_z = (0.5, 0.78) if blue else (0.34, 0.9)
    parts.append(SEDAN.body.side(rectangle((-0.92, 0.97), door_z), door))
    if blue:
        parts.append(SEDAN.body.side(rectangle((1.74, 2.05), (0.52, 0.68)), door))
        parts.append(SEDAN.body.side(rectangle((-2.1, -1.72), (0.55, 0.78)), door))
        parts.append(block((1.25, 1.9), (-0.4, 0.4), (0.7, 0.865), door).tilted(0.16, (1.6, 0.0, 0.8)))
    else:
        parts.append(SEDAN.cabin.side(rectangle((-0.9, 0.18), (1.4, 1.44)), door))
    right = BLUE_LIGHT if blue and rng.random() < 0.5 else RED_LIGHT
    parts += _light_bar(-0.25, 1.45, 0.55, right, BLUE_LIGHT)
    return varied(rng, parts, 0.02)


def taxi(rng: np.random.Generator) -> ObjectModel:
    """Return a taxi with its sign on the roof: yellow, black or cream."""
    lacquer = paint(pick(rng, ((244, 190, 24), (244, 190, 24), (30, 30, 32), (224, 212, 170))))
    form = pick(rng, (SEDAN, SEDAN, SUV))
    top = max(z for _, z in form.cabin.outline_xz_m)
    parts = [*car(form, lacquer), *tail(form)]
    parts.append(block((-0.4, -0.12), (-0.3, 0.3), (top - 0.02, top + 0.04), DARK))
    parts.append(block((-0.35, -0.17), (-0.27, 0.27), (top + 0.03, top + 0.2), Finish((250, 226, 120), 0.8)))
    chequer = DARK if lacquer.rgb[0] > 100 else paint(WHITE)
    z = form.glass_z_m[0] - 0.28
    for x in np.arange(-0.85, 0.9, 0.24):
        parts.append(form.body.side(rectangle((float(x), float(x) + 0.12), (z, z + 0.1)), chequer))
    return varied(rng, parts, 0.03)


_AMBULANCE_CAB = Shell(
    ((0.5, 0.32), (2.9, 0.32), (2.98, 0.42), (3.0, 0.9), (2.88, 1.1), (2.4, 1.24), (1.75, 2.05))
    + ((1.5, 2.15), (0.5, 2.15)),
    2.0,
    0.14,
)
_AMBULANCE_BOX = Shell(
    ((-2.98, 0.42), (1.1, 0.42), (1.1, 2.1), (0.9, 2.66), (-2.9, 2.7), (-3.0, 2.6)), 2.16, 0.03
)


def ambulance(rng: np.random.Generator) -> ObjectModel:
    """Return a white box on a van's front, with a stripe of red or orange and blue lights."""
    white = paint(WHITE)
    stripe = paint(pick(rng, ((222, 30, 30), (250, 108, 20))))
    cab, body = _AMBULANCE_CAB, _AMBULANCE_BOX
    door = ((1.15, 1.32), (2.25, 1.32), (2.1, 1.5), (1.72, 1.95), (1.15, 1.95))
    parts = [cab.mesh(white), body.mesh(white), cab.screen((1.32, 1.98), GLASS), cab.side(door, GLASS)]
    parts += [cab.lamps(0.36, (0.86, 1.08), HEADLIGHT), cab.badge((-0.45, 0.45), (0.75, 1.02), DARK)]
    parts += [cab.badge((-0.26, 0.26), (0.55, 0.67), PLATE), cab.screen((0.34, 0.4), DARK)]
    parts.append(mirrors(1.95, cab.half_m(1.4), 1.4, DARK))
    for shell, x in ((cab, 2.1), (body, -1.75)):
        side = shell.half_m(0.5)
        parts += [arches((x,), side, 0.37), wheels((x,), side + 0.02, 0.37)]
    parts += [body.side(rectangle((-2.93, 1.04), (1.15, 1.45)), stripe)]
    parts += [body.side(rectangle((-2.93, 1.04), (0.95, 1.05)), stripe)]
    parts += [cab.side(rectangle((1.14, 2.5), (1.0, 1.22)), stripe)]
    parts += [cab.badge((-0.7, 0.7), (1.13, 1.21), stripe, lift_m=0.03)]
    cross = paint((24, 70, 190))
    parts += [body.side(rectangle((-1.28, -1.08), (1.62, 2.3)), cross)]
    parts += [body.side(rectangle((-1.52, -0.84), (1.86, 2.06)), cross, 0.016)]
    parts += [body.side(rectangle((0.0, 0.8), (1.6, 2.1)), GLASS)]
    parts += [body.badge((y - 0.42, y + 0.42), (1.55, 2.2), GLASS, way=-1) for y in (-0.5, 0.5)]
    parts += [body.badge((-1.0, 1.0), (1.0, 1.3), stripe, way=-1, lift_m=0.014)]
    parts += [body.lamps(0.16, (0.6, 0.9), TAILLIGHT, way=-1)]
    parts += [body.badge((-0.26, 0.26), (0.6, 0.72), PLATE, way=-1)]
    for x in (0.55, -2.7):
        parts.append(both((x - 0.14, x + 0.14), (0.5, 0.98), (2.6, 2.84), BLUE_LIGHT))
    parts.append(block((1.3, 1.55), (-0.7, 0.7), (2.12, 2.28), BLUE_LIGHT))
    return varied(rng, parts, 0.03)
