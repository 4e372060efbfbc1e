"""What stands in the street: cones, barriers, bins, benches, hydrants, letter boxes, bollards, signs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from upvl_cli.synthetic.bodywork import Shell, block, both, pick, rectangle, varied
from upvl_cli.synthetic.cars import AMBER_LIGHT
from upvl_cli.synthetic.mesh import Mesh, Pair, ellipsoid, merge, prism, tube
from upvl_cli.synthetic.model import ObjectModel
from upvl_cli.synthetic.surface import DARK, GLASS, RUBBER, STEEL, Finish, Rgb, paint

_ORANGE = Finish((244, 92, 20), 0.5)
_WHITE_FOIL = Finish((242, 242, 240), 0.95, 0.0)
_RED_FOIL = Finish((206, 22, 30), 0.85, 0.0)
_BLUE_FOIL = Finish((24, 74, 176), 0.8, 0.0)
_CAST_IRON = Finish((52, 56, 60), 0.25)
_SLATS = Finish((138, 96, 58), 0.35)


def traffic_cone(rng: np.random.Generator) -> ObjectModel:
    """Return an orange cone with white bands."""
    size = float(pick(rng, (0.5, 0.72, 0.72, 0.95)))
    wide, bands = 0.2 * size, pick(rng, (((0.35, 0.55), (0.7, 0.82)), ((0.45, 0.75),)))
    foot = block(
        (-0.26 * size, 0.26 * size), (-0.26 * size, 0.26 * size), (0.0, 0.045), pick(rng, (_ORANGE, RUBBER))
    )

    def radius(share: float) -> float:
        return wide * (1 - share) + 0.035 * size * share

    parts = [foot, tube((0, 0, 0.03), (0, 0, size), wide, _ORANGE, end_radius_m=radius(1.0), sides=14)]
    for low, high in bands:
        start, end = 0.03 + low * (size - 0.03), 0.03 + high * (size - 0.03)
        parts.append(
            tube(
                (0, 0, start),
                (0, 0, end),
                radius(low) + 0.009,
                _WHITE_FOIL,
                end_radius_m=radius(high) + 0.009,
                sides=14,
            )
        )
    return varied(rng, parts, 0.03)


def barrier(rng: np.random.Generator) -> ObjectModel:
    """Boards with red and white stripes across the way, on feet, with lamps at times."""
    width = float(rng.uniform(1.6, 2.6))
    parts: list[Mesh] = []
    count = int(width / 0.22)
    edges = np.linspace(-width / 2, width / 2, count + 1)
    rows = pick(rng, (((0.78, 1.0), (0.3, 0.42)), ((0.72, 0.92), (0.38, 0.58)), ((0.8, 1.02),)))
    for low, high in rows:
        for n, (start, end) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            foil = (_RED_FOIL, _WHITE_FOIL)[n % 2]
            parts.append(block((-0.02, 0.02), (float(start), float(end)), (low, high), foil))
    post = width / 2 - 0.12
    parts.append(both((-0.05, -0.012), (post - 0.03, post + 0.03), (0.05, 1.05), STEEL))
    parts.append(both((-0.4, 0.4), (post - 0.06, post + 0.06), (0.0, 0.09), RUBBER))
    if rng.random() < 0.6:
        for way in (1, -1):
            y = way * post
            parts.append(block((-0.045, 0.0), (y - 0.05, y + 0.05), (1.02, 1.1), DARK))
            parts.append(tube((-0.06, y, 1.19), (0.02, y, 1.19), 0.09, AMBER_LIGHT))
    return varied(rng, parts, 0.03)


def wheelie_bin(rng: np.random.Generator) -> ObjectModel:
    """Return a household bin on two wheels."""
    colour = paint(pick(rng, ((36, 92, 52), (36, 70, 150), (44, 46, 50), (104, 72, 44), (90, 94, 98))))
    lid = paint(pick(rng, (colour.rgb, colour.rgb, (236, 196, 30), (36, 70, 150), (150, 30, 34))))
    body = Shell(((-0.22, 0.08), (0.24, 0.02), (0.31, 0.94), (-0.3, 0.94)), 0.48, -0.05)
    top = [(-0.34, 0.93), (0.35, 0.93), (0.34, 0.98), (0.1, 1.05), (-0.3, 1.04)]
    parts = [body.mesh(colour), prism(top, 0.61, lid, 0.04)]
    parts += [body.side(rectangle((-0.22, 0.22), (0.8, 0.86)), colour, 0.02)]
    parts += [tube((-0.38, -0.22, 0.97), (-0.38, 0.22, 0.97), 0.018, DARK, sides=6)]
    parts += [both((-0.4, -0.28), (0.19, 0.23), (0.95, 0.99), DARK)]
    for y in (-0.26, 0.2):
        parts.append(tube((-0.24, y, 0.1), (-0.24, y + 0.06, 0.1), 0.1, RUBBER, sides=12))
    if rng.random() < 0.5:
        parts.append(body.badge((-0.1, 0.1), (0.55, 0.75), _WHITE_FOIL))
    return varied(rng, parts, 0.08)


def bench(rng: np.random.Generator) -> ObjectModel:
    """Return a bench of wooden slats on iron feet, with a back or without."""
    width = float(rng.uniform(1.4, 2.0)) / 2
    slat = pick(rng, (_SLATS, _SLATS, Finish((96, 70, 48), 0.3), paint((40, 92, 60))))
    parts = [block((x, x + 0.1), (-width, width), (0.42, 0.46), slat) for x in (-0.22, -0.1, 0.02, 0.14)]
    foot = width - 0.18
    parts.append(both((-0.2, 0.22), (foot - 0.03, foot + 0.03), (0.36, 0.415), _CAST_IRON))
    for x in (-0.2, 0.16):
        parts.append(both((x, x + 0.06), (foot - 0.03, foot + 0.03), (0.0, 0.38), _CAST_IRON))
    if rng.random() < 0.8:
        for z in (0.54, 0.66, 0.78):
            parts.append(
                block((-0.3, -0.26), (-width, width), (z, z + 0.1), slat).tilted(-0.12, (-0.25, 0.0, 0.5))
            )
        post = both((-0.255, -0.21), (foot - 0.025, foot + 0.025), (0.4, 0.86), _CAST_IRON)
        parts.append(post.tilted(-0.12, (-0.25, 0.0, 0.5)))
        parts.append(both((-0.24, 0.2), (width - 0.06, width - 0.02), (0.62, 0.65), _CAST_IRON))
        parts.append(both((0.15, 0.19), (width - 0.055, width - 0.025), (0.455, 0.63), _CAST_IRON))
    return varied(rng, parts, 0.03)


def fire_hydrant(rng: np.random.Generator) -> ObjectModel:
    """Return a post for the fire brigade's hoses."""
    iron = paint(pick(rng, ((206, 28, 30), (206, 28, 30), (240, 190, 30), (40, 84, 170))))
    cap = pick(rng, (iron, paint((226, 226, 222)), paint((240, 190, 30))))
    parts = [
        tube((0, 0, 0.0), (0, 0, 0.07), 0.19, iron, sides=12),
        tube((0, 0, 0.05), (0, 0, 0.58), 0.125, iron, sides=12),
    ]
    parts += [
        tube((0, 0, 0.55), (0, 0, 0.61), 0.17, cap, sides=12),
        ellipsoid((0.29, 0.29, 0.3), (0, 0, 0.62), cap, sides=12),
    ]
    parts += [
        tube((0, 0, 0.74), (0, 0, 0.84), 0.04, cap, sides=6),
        tube((0, -0.23, 0.44), (0, 0.23, 0.44), 0.06, cap),
    ]
    parts += [
        tube((0, -0.2, 0.44), (0, 0.2, 0.44), 0.075, iron),
        tube((0.0, 0, 0.36), (0.21, 0, 0.36), 0.085, iron),
    ]
    parts.append(tube((0.18, 0, 0.36), (0.235, 0, 0.36), 0.07, cap))
    return varied(rng, parts, 0.06)


def post_box(rng: np.random.Generator) -> ObjectModel:
    """Return a box for letters: a red pillar, or a yellow or blue box on feet."""
    form = int(rng.integers(3))
    if form == 0:
        red = paint((200, 22, 28))
        parts = [tube((0, 0, 0), (0, 0, 0.14), 0.27, paint((28, 28, 30)), sides=16)]
        parts += [
            tube((0, 0, 0.1), (0, 0, 1.42), 0.24, red, sides=16),
            tube((0, 0, 1.4), (0, 0, 1.5), 0.29, red, sides=16),
        ]
        parts.append(tube((0, 0, 1.5), (0, 0, 1.6), 0.27, red, end_radius_m=0.08, sides=16))
        parts += [
            block((0.1, 0.252), (-0.08, 0.08), (1.2, 1.25), DARK),
            block((0.1, 0.25), (-0.07, 0.07), (0.9, 1.08), _WHITE_FOIL),
        ]
        return varied(rng, parts, 0.03)
    lacquer = paint((244, 196, 20) if form == 1 else (28, 66, 150))
    top = [(0.24 * float(np.cos(a)), 1.1 + 0.22 * float(np.sin(a))) for a in np.linspace(0, np.pi, 9)]
    body = Shell(((-0.24, 0.25), (0.24, 0.25), *top[:-1], (-0.24, 1.1)), 0.52)
    parts = [body.mesh(lacquer), block((0.1, 0.262), (-0.17, 0.17), (1.0, 1.06), DARK)]
    parts.append(block((0.1, 0.255), (-0.14, 0.14), (0.62, 0.85), _WHITE_FOIL))
    parts.append(both((-0.18, -0.12), (0.16, 0.22), (0.0, 0.3), DARK))
    parts += [both((0.12, 0.18), (0.16, 0.22), (0.0, 0.3), DARK)]
    return varied(rng, parts, 0.05)


def bollard(rng: np.random.Generator) -> ObjectModel:
    """Return a short post that keeps cars away."""
    height = float(rng.uniform(0.8, 1.05))
    lacquer: Finish = pick(rng, (_CAST_IRON, STEEL, paint((40, 44, 48)), paint((240, 190, 30))))
    wide = float(rng.uniform(0.055, 0.09))
    parts = [
        tube((0, 0, 0), (0, 0, height), wide, lacquer, sides=12),
        ellipsoid((2 * wide, 2 * wide, wide), (0, 0, height), lacquer),
    ]
    parts.append(tube((0, 0, 0), (0, 0, 0.08), wide + 0.03, lacquer, sides=12))
    for z in (height - 0.2, height - 0.38):
        parts.append(tube((0, 0, z), (0, 0, z + 0.09), wide + 0.008, _WHITE_FOIL, sides=12))
    return varied(rng, parts, 0.02)


def advertising_column(rng: np.random.Generator) -> ObjectModel:
    """Return a thick round pillar with posters."""
    grey, cap = Finish((190, 186, 176), 0.4), paint(pick(rng, ((44, 78, 62), (60, 62, 66))))
    parts = [
        tube((0, 0, 0), (0, 0, 0.35), 0.68, grey, sides=20),
        tube((0, 0, 0.3), (0, 0, 2.9), 0.6, grey, sides=20),
    ]
    parts += [tube((0, 0, 2.85), (0, 0, 3.0), 0.72, cap, sides=20)]
    parts.append(tube((0, 0, 3.0), (0, 0, 3.35), 0.66, cap, end_radius_m=0.1, sides=20))
    angle = 0.0
    while angle < 2 * np.pi - 1.0:
        step, low = float(rng.uniform(0.7, 1.0)), float(rng.uniform(0.5, 1.2))
        colours: tuple[Rgb, ...] = (
            (226, 60, 50),
            (40, 110, 180),
            (244, 214, 90),
            (230, 230, 226),
            (50, 140, 90),
        )
        poster = paint(pick(rng, colours))
        parts.append(block((0.3, 0.63), (-0.28, 0.28), (low, low + 1.3), poster).moved((0, 0, 0), angle))
        angle += step
    return varied(rng, parts, 0.05)


def _pole(height_m: float) -> Mesh:
    return tube((-0.045, 0, 0), (-0.045, 0, height_m), 0.035, STEEL, sides=8)


def _disc(size_m: float, z_m: float, x_m: Pair, foil: Finish, sides: int = 20) -> Mesh:
    """Return a flat plate that looks forward; with eight sides it stands on one of them."""
    plate = tube((x_m[0], 0, 0), (x_m[1], 0, 0), size_m, foil, sides=sides)
    cos, sin = np.cos(np.pi / sides), np.sin(np.pi / sides)
    turn = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    return replace(plate, corner_m=plate.corner_m @ turn.T).moved((0.0, 0.0, z_m))


# Strokes of the letters S, T, O and P: left and right end, lower and upper end, in shares of a letter.
_LETTERS = (
    ((0, 1, 0, 0.2), (0, 1, 0.4, 0.6), (0, 1, 0.8, 1), (0, 0.25, 0.5, 0.9), (0.75, 1, 0.1, 0.5)),
    ((0, 1, 0.8, 1), (0.37, 0.63, 0, 0.9)),
    ((0, 1, 0, 0.2), (0, 1, 0.8, 1), (0, 0.25, 0.1, 0.9), (0.75, 1, 0.1, 0.9)),
    ((0, 0.25, 0, 1), (0, 1, 0.8, 1), (0, 1, 0.4, 0.6), (0.75, 1, 0.5, 0.9)),
)


def stop_sign(rng: np.random.Generator) -> ObjectModel:
    """Return a red sign of eight sides on a pole."""
    height, size = float(rng.uniform(2.1, 2.5)), float(rng.uniform(0.36, 0.45))
    parts = [_pole(height + 0.2), _disc(size * 0.98, height, (-0.018, -0.006), STEEL, 8)]
    parts.append(_disc(size, height, (-0.01, 0.008), _WHITE_FOIL, 8))
    parts.append(_disc(size * 0.92, height, (0.0, 0.016), _RED_FOIL, 8))
    wide, tall, step = 0.26 * size, 0.5 * size, 0.36 * size
    for n, strokes in enumerate(_LETTERS):
        left = -2 * step + n * step + (step - wide) / 2
        parts += [
            block(
                (0.0, 0.025),
                (left + a * wide, left + b * wide),
                (height + (c - 0.5) * tall, height + (d - 0.5) * tall),
                _WHITE_FOIL,
            )
            for a, b, c, d in strokes
        ]
    return varied(rng, parts, 0.02)


def traffic_sign(rng: np.random.Generator) -> ObjectModel:
    """Return a round, three-cornered or square sign on a pole: a limit, no entry, give way, a warning, a crossing."""
    height = float(rng.uniform(2.0, 2.5))
    form = int(rng.integers(6))
    ink = Finish((26, 26, 30), 0.1)
    parts = [_pole(height + 0.25)]
    if form < 3:
        parts.append(_disc(0.3, height, (-0.018, -0.006), STEEL))
        parts.append(_disc(0.31, height, (-0.01, 0.008), (_RED_FOIL, _RED_FOIL, _BLUE_FOIL)[form]))
    if form == 0:
        parts += [_disc(0.24, height, (0.0, 0.016), _WHITE_FOIL), *_number(height, ink)]
    elif form == 1:
        parts.append(block((0.0, 0.02), (-0.22, 0.22), (height - 0.05, height + 0.05), _WHITE_FOIL))
    elif form == 2:
        parts += [block((0.0, 0.02), (-0.03, 0.03), (height - 0.18, height + 0.12), _WHITE_FOIL)]
        parts.append(tube((0.0, 0, height + 0.12), (0.021, 0, height + 0.12), 0.09, _WHITE_FOIL, sides=3))
    elif form < 5:
        turn = np.pi * (form == 4)
        plates = (
            (0.48, (-0.018, -0.006), STEEL),
            (0.5, (-0.01, 0.008), _RED_FOIL),
            (0.34, (0.0, 0.016), _WHITE_FOIL),
        )
        parts += [_triangle(size, height, x, foil, float(turn)) for size, x, foil in plates]
        if form == 3:
            parts.append(block((0.0, 0.025), (-0.02, 0.02), (height - 0.06, height + 0.13), ink))
    else:
        square = (height - 0.3, height + 0.3)
        parts += [block((-0.018, -0.006), (-0.29, 0.29), (height - 0.29, height + 0.29), STEEL)]
        parts += [block((-0.01, 0.008), (-0.3, 0.3), square, _BLUE_FOIL)]
        parts.append(_triangle(0.3, height - 0.04, (0.0, 0.016), _WHITE_FOIL, 0.0))
        parts.append(block((0.0, 0.024), (-0.02, 0.02), (height - 0.14, height + 0.08), ink))
    return varied(rng, parts, 0.03)


def _triangle(size_m: float, z_m: float, x_m: Pair, foil: Finish, turn_rad: float) -> Mesh:
    """Return a plate of three corners, one of them on top."""
    angle = turn_rad + np.pi / 2 + np.arange(3) * 2 * np.pi / 3
    outline = [(size_m * float(np.cos(a)), z_m + size_m * float(np.sin(a))) for a in angle]
    plate = prism(outline, x_m[1] - x_m[0], foil)
    return plate.moved(((x_m[0] + x_m[1]) / 2, 0.0, 0.0), np.pi / 2)


def _number(z_m: float, ink: Finish) -> list[Mesh]:
    """Return a 30 or so."""
    zero = ((0, 1, 0, 0.2), (0, 1, 0.8, 1), (0, 0.25, 0.1, 0.9), (0.75, 1, 0.1, 0.9))
    three = ((0, 1, 0, 0.2), (0.2, 1, 0.4, 0.6), (0, 1, 0.8, 1), (0.75, 1, 0.1, 0.9))
    return [
        block((0.0, 0.024), (y + a * 0.11, y + b * 0.11), (z_m - 0.11 + c * 0.22, z_m - 0.11 + d * 0.22), ink)
        for y, strokes in ((-0.14, three), (0.03, zero))
        for a, b, c, d in strokes
    ]


def traffic_light(rng: np.random.Generator) -> ObjectModel:
    """Three lamps on a pole, one of which shines."""
    height = float(rng.uniform(2.3, 2.8))
    case = DARK if rng.random() < 0.6 else paint((240, 190, 30))
    lit = int(rng.integers(3))
    shine: tuple[Rgb, ...] = ((255, 50, 40), (255, 190, 40), (60, 240, 120))
    parts = [tube((-0.1, 0, 0), (-0.1, 0, height + 0.9), 0.06, _CAST_IRON)]
    parts += [block((-0.05, 0.15), (-0.16, 0.16), (height, height + 0.95), case)]
    for n in range(3):
        z = height + 0.78 - 0.3 * n
        red, green, blue = shine[n]
        rgb: Rgb = shine[n] if n == lit else (red // 4, green // 4, blue // 4)
        parts.append(tube((0.1, 0, z), (0.165, 0, z), 0.11, Finish(rgb, 0.5), sides=12))
        parts.append(block((0.14, 0.3), (-0.12, 0.12), (z + 0.115, z + 0.13), case))
    if rng.random() < 0.5:
        parts.append(block((-0.06, 0.08), (-0.12, 0.12), (1.0, 1.18), paint((240, 190, 30))))
        parts.append(block((0.0, 0.09), (-0.06, 0.06), (1.04, 1.14), GLASS))
    return varied(rng, parts, 0.02)


def rubbish_bags(rng: np.random.Generator) -> ObjectModel:
    """Sacks of rubbish in a heap."""
    sack = Finish(pick(rng, ((30, 30, 34), (30, 30, 34), (50, 100, 60))), 0.15, gloss=0.2)
    parts = []
    for _ in range(int(rng.integers(3, 7))):
        x, y = (float(v) for v in rng.uniform(-0.45, 0.45, 2))
        size = float(rng.uniform(0.45, 0.65))
        bag = [ellipsoid((size, size * 0.9, size), (x, y, size * 0.46), sack, sides=8)]
        bag.append(tube((x, y, size * 0.88), (x, y, size * 1.12), 0.03, sack, end_radius_m=0.08, sides=6))
        parts.append(merge(bag))
    return varied(rng, parts, 0.05)
