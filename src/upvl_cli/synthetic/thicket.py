"""What grows wild: bushes and hedges with ragged leaves, and tufts of grass. Rays pass between their leaves."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic import mesh
from upvl_cli.synthetic.greenery import rough, tinted
from upvl_cli.synthetic.mesh import Mesh, Triple
from upvl_cli.synthetic.surface import BARK, GRASS, LEAVES, Finish
from upvl_cli.types import Array, Floats

_LEAVES_PER_M2 = 30.0  # of a bush's outer surface: some three quarters of the rays meet one
_LEAF_M = (0.10, 0.26)  # a leaf stands for a twig with its leaves
_LOBE_M = 0.55  # a bush has about one lobe to this length
_MOST_LEAVES = 900
_WILD = LEAVES._replace(depth_m=0.06, dropout=0.12)


def bush(size_lwh_m: Triple, rng: np.random.Generator, *, fine: bool) -> Mesh:
    """Return a ragged bush around the origin, along x.

    Args:
        size_lwh_m: About how long, wide and high it is.
        rng: What it looks like.
        fine: Whether to spend triangles on it.
    """
    size = np.array(size_lwh_m)
    finish = tinted(_WILD, rng, 28)
    if not fine:
        return rough(mesh.ellipsoid(size_lwh_m, (0.0, 0.0, 0.45 * size_lwh_m[2]), finish, sides=8), rng)
    lobes = int(np.clip(np.prod(size[:2]) / _LOBE_M**2, 2, 14))
    middle = rng.uniform(-0.5, 0.5, (lobes, 3)) * size * [0.75, 0.6, 0.35] + [0, 0, 0.5 * size[2]]
    radius = np.minimum(rng.uniform(0.28, 0.5, (lobes, 1)) * size[1:].min(), 0.55 * size[2]) * [
        1.15,
        1.15,
        1.0,
    ]
    count = int(min(_LEAVES_PER_M2 * _surface_m2(size), _MOST_LEAVES))
    lobe = rng.integers(lobes, size=count)
    away = rng.normal(size=(count, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    # Most leaves are outside; some stand out of the outline.
    place = middle[lobe] + away * radius[lobe] * rng.uniform(0.6, 1.15, (count, 1))
    place[:, 2] = np.abs(place[:, 2])
    core = mesh.ellipsoid(_triple(size * 0.55), (0.0, 0.0, 0.45 * float(size[2])), finish, sides=8)
    stem = mesh.tube((0.0, 0.0, -0.3), (0.0, 0.0, 0.5 * float(size[2])), 0.04, BARK, sides=5)
    return mesh.merge([leaves(place, finish, rng), rough(core, rng), stem])


def hedge(length_m: float, width_m: float, height_m: float, rng: np.random.Generator, *, fine: bool) -> Mesh:
    """Return a stretch of ragged hedge along x around the origin: a rough core, and leaves that stand out of it."""
    finish = tinted(_WILD, rng, 20)
    core = mesh.box((length_m, 0.7 * width_m, 0.9 * height_m), (0.0, 0.0, 0.45 * height_m), finish)
    if not fine:
        return core
    count = int(min(_LEAVES_PER_M2 * length_m * (width_m + 2 * height_m), _MOST_LEAVES))
    around = rng.uniform(-1, 1, count) * (width_m / 2 + height_m)
    x = rng.uniform(-0.5, 0.5, count) * length_m
    y = np.clip(around, -width_m / 2, width_m / 2)
    z = height_m - (np.abs(around) - np.abs(y))
    ragged = rng.normal(0, 0.09, (count, 3))
    return mesh.merge([core, leaves(np.column_stack([x, y, np.maximum(z, 0.02)]) + ragged, finish, rng)])


def tufts(place_m: Array, rng: np.random.Generator) -> Mesh:
    """Tall grass on (n, 3) places: blades of up to half a metre that lean outwards."""
    blades = np.repeat(np.asarray(place_m), 6, axis=0)
    count = len(blades)
    turn, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.12, 0.5, count)
    lean = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(count)])
    wide = np.column_stack([-np.sin(turn), np.cos(turn), np.zeros(count)]) * 0.05
    top = blades + lean * (0.35 * height)[:, None] + np.array([0, 0, 1]) * height[:, None]
    corners = np.stack([blades - wide, blades + wide, top], axis=1).reshape(-1, 3)
    return mesh.of(corners, np.arange(3 * count).reshape(-1, 3), tinted(GRASS, rng, 20))


def leaves(place_m: Array, finish: Finish, rng: np.random.Generator) -> Mesh:
    """Triangles of any direction around (n, 3) places."""
    count = len(place_m)
    size = rng.uniform(*_LEAF_M, (count, 1, 1))
    corner = rng.normal(size=(count, 3, 3))
    corner -= corner.mean(axis=1, keepdims=True)
    corner *= size / np.linalg.norm(corner, axis=2).max(axis=1)[:, None, None]
    corners = (np.asarray(place_m)[:, None] + corner).reshape(-1, 3)
    return mesh.of(corners, np.arange(3 * count).reshape(-1, 3), finish)


def _surface_m2(size_m: Floats) -> float:
    """Surface of an ellipsoid, by Thomsen's formula (to 1 %)."""
    a, b, c = (size_m / 2) ** 1.6075
    return float(4 * np.pi * ((a * b + a * c + b * c) / 3) ** (1 / 1.6075))


def _triple(values: Array) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
