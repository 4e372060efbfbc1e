"""Those who walk: adults, children, joggers, people with prams, umbrellas or wheelchairs, and dogs."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic.bodywork import block, both, pick, ring, spokes, varied
from upvl_cli.synthetic.figure import TOPS, Appearance, head, look, reach, seated_leg, torso, walker
from upvl_cli.synthetic.mesh import Mesh, ellipsoid, merge, prism, tube
from upvl_cli.synthetic.model import ObjectModel, Part
from upvl_cli.synthetic.surface import CHROME, DARK, RUBBER, STEEL, Finish, cloth


def _backpack(who: Appearance, colour: Finish) -> Mesh:
    tall = who.height_m
    return block(
        (-0.17 * tall, -0.06 * tall), (-0.085 * tall, 0.085 * tall), (0.57 * tall, 0.79 * tall), colour
    )


def _skirt(who: Appearance, low: float) -> Mesh:
    tall, thick = who.height_m, who.height_m * who.girth
    return tube(
        (0, 0, low * tall), (0, 0, 0.56 * tall), 0.16 * thick, cloth(who.top.rgb), end_radius_m=0.08 * thick
    )


def _hat(who: Appearance, colour: Finish) -> Mesh:
    tall = who.height_m
    size = 0.13 * tall * who.head
    top = 0.863 * tall + size
    return merge(
        [
            tube((0, 0, top - 0.3 * size), (0, 0, top + 0.06), 0.5 * size, colour, end_radius_m=0.38 * size),
            tube((0.03, 0, top - 0.32 * size), (0.03, 0, top - 0.22 * size), 0.68 * size, colour),
        ]
    )


def adult(rng: np.random.Generator) -> ObjectModel:
    """Return a man or a woman; at times with a skirt, a backpack, a bag or a hat."""
    who = look(rng)
    skirt = who.long_hair and rng.random() < 0.5
    bare, sleeves = bool(skirt or rng.random() < 0.12), bool(rng.random() < 0.7)
    carried, colour = int(rng.integers(4)), cloth(pick(rng, TOPS))
    parts = walker(who, shorts=bare, sleeves=sleeves, bag=colour if carried == 0 else None)
    if skirt:
        parts.append(_skirt(who, 0.27))
    if carried == 1:
        parts.append(_backpack(who, colour))
    if rng.random() < 0.12:
        parts.append(_hat(who, colour))
    return varied(rng, parts, 0.01)


def child(rng: np.random.Generator) -> ObjectModel:
    """Return a boy or a girl, at times with a school bag."""
    who = look(rng, child=True)
    parts = walker(who, shorts=bool(rng.random() < 0.35), sleeves=bool(rng.random() < 0.5))
    if rng.random() < 0.4:
        parts.append(_backpack(who, cloth(pick(rng, TOPS))))
    if who.long_hair and rng.random() < 0.5:
        parts.append(_skirt(who, 0.33))
    return varied(rng, parts, 0.01)


def jogger(rng: np.random.Generator) -> ObjectModel:
    """Somebody who runs, in shorts and a bright shirt."""
    bright = cloth(pick(rng, ((244, 240, 60), (250, 110, 40), (60, 220, 120), (240, 60, 120))))
    who = look(rng)._replace(top=bright, trousers=cloth((30, 30, 36)), shoes=bright, girth=0.92)
    return varied(rng, walker(who, stride=0.7, sleeves=False, shorts=True), 0.01)


def person_with_umbrella(rng: np.random.Generator) -> ObjectModel:
    """Somebody below an open umbrella."""
    who = look(rng)
    tall = who.height_m
    cover = cloth(pick(rng, (*TOPS, (30, 30, 34), (30, 30, 34))))
    parts = [*walker(who, arms=False), reach(who, 0.0, 0.805 * tall, (0.2, 0.06, 0.64 * tall))]
    parts.append(tube((0.2, 0.0, 0.58 * tall), (0.12, 0.0, tall + 0.33), 0.012, STEEL, sides=5))
    top = tall + 0.32
    parts.append(tube((0.12, 0, top - 0.27), (0.12, 0, top - 0.1), 0.55, cover, end_radius_m=0.38, sides=8))
    parts.append(tube((0.12, 0, top - 0.1), (0.12, 0, top), 0.38, cover, end_radius_m=0.03, sides=8))
    return varied(rng, parts, 0.01)


def _wheel(
    x: float, y: float, radius: float, rim: Finish = STEEL, thick: float = 0.035, pieces: int = 12
) -> Mesh:
    centre = (x, y, radius)
    hub = tube((x, y - 0.03, radius), (x, y + 0.03, radius), 0.03, rim, sides=6)
    return merge([ring(centre, radius, thick, RUBBER, pieces), spokes(centre, radius - thick, rim), hub])


def pram(rng: np.random.Generator) -> ObjectModel:
    """Somebody who pushes a pram."""
    who = look(rng)
    tall = who.height_m
    cover = cloth(pick(rng, TOPS))
    handle = 0.98
    parts = [*walker(who, stride=0.35, arms=False, x_m=-0.62)]
    parts.append(reach(who, -0.62, 0.805 * tall, (-0.22, 0.2, handle)))
    tub = [(0.02, 0.6), (0.1, 0.47), (0.75, 0.47), (0.88, 0.62), (0.88, 0.74), (0.0, 0.74)]
    hood = [(0.42, 0.73), (0.86, 0.745), (0.93, 0.92), (0.86, 1.04), (0.7, 1.09), (0.5, 1.02)]
    parts += [prism(tub, 0.42, cover, -0.03), prism(hood, 0.46, DARK, 0.04)]
    parts.append(block((0.06, 0.5), (-0.19, 0.19), (0.72, 0.78), cloth((236, 232, 222))))
    for way in (1, -1):
        y = way * 0.25
        parts += [_wheel(0.1, y, 0.17, thick=0.05, pieces=10), _wheel(0.75, y, 0.17, thick=0.05, pieces=10)]
        parts.append(tube((0.75, y * 0.8, 0.17), (-0.22, y * 0.8, handle), 0.014, CHROME, sides=5))
        parts.append(tube((0.1, y * 0.8, 0.17), (0.7, y * 0.8, 0.5), 0.014, CHROME, sides=5))
    parts.append(tube((-0.22, -0.24, handle), (-0.22, 0.24, handle), 0.02, DARK, sides=6))
    return varied(rng, parts, 0.02)


def wheelchair_user(rng: np.random.Generator) -> ObjectModel:
    """Somebody who sits in a wheelchair."""
    who = look(rng)
    tall = who.height_m
    seat, rim = 0.52, cloth(pick(rng, ((30, 30, 34), (30, 60, 140), (150, 24, 30))))
    hip = (-0.12, 0.0, seat + 0.1)
    neck = (-0.18, 0.0, seat + 0.1 + 0.315 * tall)
    parts: list[Part | Mesh] = [torso(who, hip, neck), head(who, neck)]
    for way in (1, -1):
        y = way * 0.11
        parts.append(seated_leg(who, (-0.1, y, seat + 0.1), (0.34, y, seat + 0.1), (0.44, y, 0.2)))
        parts.append(_wheel(-0.15, way * 0.31, 0.31, CHROME, 0.04, 16))
        parts.append(_wheel(0.34, way * 0.24, 0.09, STEEL, 0.045, 8))
        parts.append(block((0.345, 0.67), (y - 0.08, y + 0.08), (0.11, 0.14), DARK))
        rail = way * 0.25
        parts.append(tube((0.3, rail, seat), (0.42, rail, 0.12), 0.015, STEEL, sides=5))
        parts.append(block((-0.28, 0.16), (rail - 0.025, rail + 0.025), (0.73, 0.77), DARK))
        parts.append(tube((-0.32, rail, 0.3), (-0.36, rail, 0.98), 0.016, STEEL, sides=5))
        parts.append(tube((-0.35, rail, 0.96), (-0.46, rail, 0.97), 0.022, DARK, sides=5))
    parts.append(reach(who, -0.16, hip[2] + 0.27 * tall, (0.06, 0.26, 0.81)))
    parts += [block((-0.32, 0.3), (-0.23, 0.23), (seat - 0.03, seat + 0.03), rim)]
    parts.append(block((-0.36, -0.31), (-0.23, 0.23), (seat, 0.93), rim))
    parts.append(both((-0.31, 0.29), (0.225, 0.245), (seat, seat + 0.2), rim))
    return varied(rng, parts, 0.02)


_COATS = ((60, 44, 34), (30, 28, 28), (196, 154, 96), (226, 218, 204), (140, 92, 54), (120, 118, 116))


def dog(rng: np.random.Generator) -> ObjectModel:
    """Return a dog, with legs that swing."""
    size = float(rng.uniform(0.6, 1.1))
    coat = Finish(pick(rng, _COATS), 0.35, depth_m=0.01, texture="cloth")
    patch = Finish(pick(rng, _COATS), 0.35, texture="cloth")
    stout, shank = size * float(rng.uniform(0.85, 1.25)), 0.3 * size * float(rng.uniform(0.8, 1.1))
    back = shank + 0.17 * size
    parts: list[Part | Mesh] = [
        ellipsoid((0.34 * size, 0.24 * stout, 0.3 * size), (0.13 * size, 0, back), coat),
        tube(
            (0.15 * size, 0, back),
            (-0.25 * size, 0, back + 0.01),
            0.115 * stout,
            coat,
            end_radius_m=0.09 * stout,
        ),
        ellipsoid((0.24 * size, 0.2 * stout, 0.24 * size), (-0.25 * size, 0, back), coat, sides=8),
        tube(
            (0.2 * size, 0, back + 0.03 * size),
            (0.36 * size, 0, back + 0.2 * size),
            0.09 * stout,
            coat,
            end_radius_m=0.065 * stout,
        ),
    ]
    x, z = 0.4 * size, back + 0.24 * size
    parts.append(ellipsoid((0.2 * size, 0.15 * stout, 0.16 * size), (x, 0, z), patch))
    snout = x + 0.2 * size
    parts.append(
        tube(
            (x, 0, z - 0.02 * size),
            (snout, 0, z - 0.045 * size),
            0.06 * size,
            coat,
            end_radius_m=0.035 * size,
        )
    )
    parts.append(ellipsoid((0.035 * size,) * 3, (snout, 0, z - 0.035 * size), DARK, sides=6))
    ear = 0.07 * size if rng.random() < 0.5 else -0.08 * size
    for way in (1, -1):
        root, tip = (x - 0.04 * size, way * 0.055 * stout), (x - 0.05 * size, way * 0.085 * stout)
        top = z + 0.05 * size
        parts.append(tube((*root, top), (*tip, top + ear), 0.035 * size, patch, end_radius_m=0.01, sides=5))
    tail = (-0.5 * size, 0.0, back + float(rng.uniform(-0.05, 0.22)) * size)
    parts.append(tube((-0.34 * size, 0, back + 0.03), tail, 0.03 * size, coat, end_radius_m=0.012, sides=6))
    for front, phase in ((True, 0.0), (False, np.pi)):
        for way in (1, -1):
            hip = (0.19 * size if front else -0.27 * size, way * 0.075 * stout, back - 0.03 * size)
            foot = (hip[0], hip[1], 0.035 * size)
            knee = (hip[0] - (0.0 if front else 0.04 * size), hip[1], hip[2] * 0.5)
            leg = [
                tube(hip, knee, 0.055 * size, coat, end_radius_m=0.032 * size, sides=6),
                tube(knee, foot, 0.032 * size, coat, end_radius_m=0.024 * size, sides=6),
                block(
                    (foot[0] - 0.03 * size, foot[0] + 0.055 * size),
                    (foot[1] - 0.03 * size, foot[1] + 0.03 * size),
                    (0.0, 0.05 * size),
                    patch,
                ),
            ]
            parts.append(Part(merge(leg), 0.4, hip, phase + (0.0 if way == 1 else np.pi)))
    return varied(rng, parts, 0.03)
