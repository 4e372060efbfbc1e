"""Cars: saloons, sport utility vehicles, pickups, vans, taxis, police cars and ambulances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, arches, block, both, pick, rectangle, varied, wheels
from upvl_cli.synthetic.mesh import Mesh, Pair, box
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

BLUE_LIGHT = Finish((24, 84, 236), 0.6, gloss=0.3)
RED_LIGHT = Finish((226, 24, 30), 0.7, gloss=0.3)
AMBER_LIGHT = Finish((250, 160, 20), 0.7, gloss=0.3)
WHITE: Rgb = (238, 238, 236)
PAINTS: tuple[Rgb, ...] = (
    WHITE,
    (26, 27, 30),
    (182, 186, 190),
    (104, 108, 114),
    (28, 52, 110),
    (168, 26, 32),
    (52, 104, 168),
    (44, 84, 62),
    (176, 158, 130),
    (214, 106, 32),
    (92, 34, 44),
    (112, 160, 186),
)


class Form(NamedTuple):
    """What one car differs by from others.

    Attributes:
        body: All below the windows.
        cabin: All from the windows on.
        glass_z_m: Lower and upper edge of the windows.
        windows: Span of each side window, 0 at the cabin's rear and 1 at its front.
        wheel_x_m: Places of the axles.
        wheel_m: Radius of the wheels.
        seams_x_m: Edges of the doors.
        lamp_z_m: Lower and upper edge of the headlights.
        tail_z_m: The same of the tail-lights.
    """

    body: Shell
    cabin: Shell
    glass_z_m: Pair
    windows: tuple[Pair, ...]
    wheel_x_m: tuple[float, ...]
    wheel_m: float
    seams_x_m: tuple[float, ...]
    lamp_z_m: Pair
    tail_z_m: Pair


SEDAN = Form(
    Shell(
        ((-2.12, 0.2), (2.1, 0.2), (2.22, 0.3), (2.25, 0.52), (2.18, 0.7), (1.95, 0.78))
        + ((1.0, 0.94), (-1.6, 0.99), (-2.16, 0.97), (-2.25, 0.86), (-2.25, 0.4)),
        1.8,
        0.07,
    ),
    Shell(((-1.95, 0.9), (1.2, 0.9), (0.38, 1.4), (0.2, 1.45), (-0.95, 1.45), (-1.15, 1.41)), 1.64, 0.2),
    (1.0, 1.37),
    ((0.52, 0.93), (0.09, 0.48)),
    (-1.32, 1.36),
    0.32,
    (-0.95, 0.05, 1.0),
    (0.55, 0.68),
    (0.66, 0.84),
)
HATCHBACK = Form(
    Shell(
        ((-1.85, 0.2), (1.88, 0.2), (1.97, 0.3), (2.0, 0.55), (1.94, 0.72), (1.75, 0.82))
        + ((1.0, 0.97), (-1.8, 1.0), (-1.96, 0.95), (-2.0, 0.6), (-1.97, 0.35)),
        1.74,
        0.06,
    ),
    Shell(((-1.97, 0.92), (1.25, 0.92), (0.5, 1.42), (0.3, 1.47), (-1.35, 1.47), (-1.62, 1.43)), 1.6, 0.17),
    (1.03, 1.39),
    ((0.55, 0.94), (0.14, 0.51)),
    (-1.25, 1.28),
    0.31,
    (-0.85, 0.15, 1.05),
    (0.58, 0.74),
    (0.72, 0.92),
)
SUV = Form(
    Shell(
        ((-2.2, 0.28), (2.2, 0.28), (2.33, 0.4), (2.35, 0.75), (2.27, 0.94), (2.05, 1.02))
        + ((1.15, 1.12), (-2.2, 1.14), (-2.32, 1.1), (-2.35, 0.7), (-2.32, 0.42)),
        1.9,
        0.06,
    ),
    Shell(((-2.32, 1.05), (1.35, 1.05), (0.68, 1.65), (0.45, 1.71), (-1.85, 1.7), (-2.05, 1.64)), 1.78, 0.17),
    (1.17, 1.62),
    ((0.62, 0.94), (0.31, 0.59), (0.08, 0.28)),
    (-1.4, 1.42),
    0.38,
    (-1.0, 0.1, 1.1),
    (0.74, 0.92),
    (0.78, 1.06),
)


def lights(form: Form) -> list[Mesh]:
    """Headlights, grill, plate and lower edge of the front."""
    body = form.body
    grill = (form.lamp_z_m[0] - 0.1, form.lamp_z_m[1] - 0.04)
    low = min(z for _, z in body.outline_xz_m)
    return [
        body.lamps(0.38, form.lamp_z_m, HEADLIGHT),
        body.badge((-0.45, 0.45), grill, DARK),
        body.badge((-0.26, 0.26), (grill[0] - 0.06, grill[0] + 0.06), PLATE, lift_m=0.03),
        body.screen((low + 0.12, low + 0.2), DARK, margin_m=0.25),
    ]


def tail(form: Form) -> list[Mesh]:
    """Lights, plate and bumper of the rear."""
    body, (low, high) = form.body, form.tail_z_m
    sill = min(z for _, z in body.outline_xz_m)
    return [
        body.lamps(0.3, (low, high), TAILLIGHT, way=-1),
        body.badge((-0.26, 0.26), (low - 0.1, low + 0.02), PLATE, way=-1),
        body.screen((sill + 0.14, sill + 0.24), DARK, way=-1, margin_m=0.2),
    ]


def mirrors(x_m: float, y_m: float, z_m: float, surface: Finish) -> Mesh:
    """Mirrors on both sides of a body whose side is so far out."""
    return both((x_m - 0.06, x_m + 0.08), (y_m - 0.05, y_m + 0.17), (z_m, z_m + 0.14), surface)


def rolling(form: Form) -> list[Mesh]:
    """Wheels and the dark above them."""
    side = form.body.half_m(form.wheel_m)
    return [
        arches(form.wheel_x_m, side, form.wheel_m),
        wheels(form.wheel_x_m, side + 0.02, form.wheel_m),
    ]


def car(form: Form, lacquer: Finish) -> list[Mesh]:
    """Return a car without its tail and anything on its roof."""
    body, cabin, (low, high) = form.body, form.cabin, form.glass_z_m
    sill = min(z for _, z in body.outline_xz_m) + 0.12
    belt = low - 0.1
    parts = [body.mesh(lacquer), cabin.mesh(lacquer), *lights(form), *rolling(form)]
    parts += [cabin.screen((low, high), GLASS, way=way) for way in (1, -1)]
    parts += [cabin.window(span, (low, high), GLASS) for span in form.windows]
    parts += [body.side(rectangle((x - 0.008, x + 0.008), (sill, belt)), DARK, 0.02) for x in form.seams_x_m]
    parts += [
        body.side(rectangle((x + 0.08, x + 0.24), (belt - 0.1, belt - 0.06)), CHROME, 0.025)
        for x in form.seams_x_m[:-1]
    ]
    parts.append(mirrors(cabin.end_m(low, 1) - 0.45, cabin.half_m(low), low, lacquer))
    return parts


def _rails(form: Form, x_m: Pair) -> list[Mesh]:
    """Rails along the roof."""
    top = max(z for _, z in form.cabin.outline_xz_m)
    half = form.cabin.half_m(top) - 0.08
    return [both(x_m, (half - 0.04, half), (top - 0.02, top + 0.05), STEEL)]


def _load(rng: np.random.Generator, form: Form, x_m: Pair) -> list[Mesh]:
    """Return a roof rack, and perhaps a roof box on it."""
    top = max(z for _, z in form.cabin.outline_xz_m)
    half = form.cabin.half_m(top)
    bars = [
        block((x - 0.03, x + 0.03), (-half, half), (top + 0.03, top + 0.07), DARK)
        for x in (x_m[0] + 0.2, x_m[1] - 0.2)
    ]
    middle = (x_m[0] + x_m[1]) / 2
    load = box((1.5, 0.7, 0.3), (middle, 0.15, top + 0.23), pick(rng, (DARK, STEEL)))
    return [*_rails(form, x_m), *bars, *([load] if rng.random() < 0.5 else [])]


def sedan(rng: np.random.Generator) -> ObjectModel:
    """Return a saloon."""
    parts = [*car(SEDAN, paint(pick(rng, PAINTS))), *tail(SEDAN)]
    if rng.random() < 0.1:
        parts += _load(rng, SEDAN, (-0.9, 0.15))
    return varied(rng, parts)


def hatchback(rng: np.random.Generator) -> ObjectModel:
    """Return a small car with a steep rear."""
    parts = [*car(HATCHBACK, paint(pick(rng, PAINTS))), *tail(HATCHBACK)]
    if rng.random() < 0.2:
        parts += _load(rng, HATCHBACK, (-1.3, 0.25))
    return varied(rng, parts, 0.05)


def suv(rng: np.random.Generator) -> ObjectModel:
    """Return a sport utility vehicle: high, with dark plastic around its lower edge."""
    lacquer = paint(pick(rng, PAINTS))
    parts = [*car(SUV, lacquer), *tail(SUV), *_rails(SUV, (-1.8, 0.4))]
    parts.append(SUV.body.side(rectangle((-0.85, 0.9), (0.3, 0.45)), DARK, 0.03))
    if rng.random() < 0.15:
        parts += _load(rng, SUV, (-1.7, 0.3))
    return varied(rng, parts)
