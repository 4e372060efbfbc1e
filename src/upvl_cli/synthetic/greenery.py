"""What grows in the city and what stands around gardens: trees, hedges, fences and walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from upvl_cli.synthetic import mesh
from upvl_cli.synthetic.ground import near, spot
from upvl_cli.synthetic.mesh import Mesh, Triple
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import Road
from upvl_cli.synthetic.surface import (
    BARK,
    BRICK,
    CONCRETE,
    LEAVES,
    PLASTER,
    STEEL,
    WOOD,
    Finish,
    Rgb,
)
from upvl_cli.types import Array

_PANEL_M = 2.4  # length of one panel of a wall or a fence
_HEDGE_STEP_M = 0.8
_FENCES: tuple[Finish, ...] = (
    WOOD,
    WOOD._replace(rgb=(104, 84, 62)),
    WOOD._replace(rgb=(222, 220, 210), reflectance=0.6),
    STEEL._replace(rgb=(62, 72, 66), reflectance=0.25),
)

# Corners of a block (1: high x, 2: high y, 4: high z) of its twelve triangles.
_BLOCK = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4]]
    + [[2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]
)


def tinted(surface: Finish, rng: np.random.Generator, spread: int) -> Finish:
    """Return the same material in a colour that differs by chance, most of all in brightness."""
    shift = int(rng.integers(-spread, spread + 1)) + rng.integers(-4, 5, 3)
    red, green, blue = (int(v) for v in np.clip(np.array(surface.rgb) + shift, 8, 247))
    rgb: Rgb = (red, green, blue)
    return surface._replace(rgb=rgb)


def tree(place_m: Triple, rng: np.random.Generator, *, street: bool, fine: bool) -> Piece:
    """Return a tree.

    Args:
        place_m: Where it stands on the ground.
        rng: What it looks like.
        street: Whether people and vehicles pass below, so that it has no low branches.
        fine: Whether to spend triangles on it.
    """
    kind = rng.choice(["round", "poplar", "conifer"], p=[0.75, 0.25, 0.0] if street else [0.6, 0.12, 0.28])
    leaves = tinted(LEAVES, rng, 18)
    if kind == "conifer":
        grown = _conifer(rng, leaves._replace(rgb=(38, 78, 48)), fine)
    else:
        grown = _leafy(rng, leaves, fine, clear_m=3.5 if street else 2.0, slim=kind == "poplar")
    return Piece("tree", _turned(grown, place_m, rng))


def bushes(
    road: Road, rng: np.random.Generator, side: int, s_m: tuple[float, float], away_m: float
) -> list[Piece]:
    """Return a few bushes at a distance from the middle of the street."""
    places = [spot(road, rng.uniform(*s_m), side * away_m) for _ in range(rng.integers(0, 3))]
    return [Piece("hedge", _turned(_bush(rng), place, rng)) for place in places]


def edge(road: Road, rng: np.random.Generator, side: int, first_m: float, last_m: float) -> Piece:
    """Return a wall, a fence or a hedge between two s along the back of the pavement."""
    name = str(rng.choice(["wall", "fence", "hedge"], p=[0.25, 0.35, 0.4]))
    step = _HEDGE_STEP_M if name == "hedge" else _PANEL_M
    count = max(round((last_m - first_m) / step), 1)
    s = np.linspace(first_m + 0.15, last_m - 0.15, count + 1)
    places = road.place(s, np.array(side * (road.front_m + 0.4)))
    if name == "hedge":
        return Piece(name, _hedge(places, rng))
    steps = np.diff(places, axis=0)
    length = float(np.linalg.norm(steps, axis=1).mean())
    panel = _wall(length, rng) if name == "wall" else _fence(length, rng, near(first_m))
    middles = (places[1:] + places[:-1]) / 2
    yaws = np.arctan2(steps[:, 1], steps[:, 0])
    moved = [panel.moved((x, y, z), float(yaw)) for (x, y, z), yaw in zip(middles, yaws, strict=True)]
    return Piece(name, mesh.merge(moved))


def _turned(grown: Mesh, place_m: Triple, rng: np.random.Generator) -> Mesh:
    return grown.moved(place_m, rng.uniform(0, 2 * np.pi))


def _bush(rng: np.random.Generator) -> Mesh:
    width, height = rng.uniform(0.8, 1.6), rng.uniform(0.7, 1.4)
    leaves = tinted(LEAVES, rng, 25)
    return rough(mesh.ellipsoid((width, width, height), (0.0, 0.0, height * 0.42), leaves), rng)


def blocks(low_m: Array, high_m: Array, surface: Finish) -> Mesh:
    """Blocks along the axes between (n, 3) lowest and highest corners."""
    bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
    corners = np.where(bits[None], np.asarray(high_m)[:, None], np.asarray(low_m)[:, None])
    face = 8 * np.arange(len(corners))[:, None, None] + _BLOCK
    return mesh.of(corners.reshape(-1, 3), face, surface)


def rough(part: Mesh, rng: np.random.Generator) -> Mesh:
    """Return the same with an uneven surface."""
    middle = part.corner_m.mean(axis=0)
    factor = rng.uniform(0.86, 1.14, (len(part.corner_m), 1))
    return replace(part, corner_m=middle + (part.corner_m - middle) * factor)


def _leafy(rng: np.random.Generator, leaves: Finish, fine: bool, *, clear_m: float, slim: bool) -> Mesh:
    """Trunk, branches and a crown of several balls, which starts at least so high."""
    wide = rng.uniform(1.0, 1.3) if slim else rng.uniform(1.6, 2.1)
    tall = rng.uniform(5.0, 8.0) if slim else rng.uniform(4.0, 6.2)
    low = clear_m + rng.uniform(0.0, 0.6)
    radius = rng.uniform(0.11, 0.19)
    top = low + tall * 0.55
    bark, shades = tinted(BARK, rng, 12), (leaves, tinted(leaves, rng, 9))
    parts = [mesh.tube((0.0, 0.0, -0.3), (0.0, 0.0, top), radius, bark, end_radius_m=radius * 0.5, sides=8)]
    count = int(rng.integers(5, 9)) if fine else 3
    turn = rng.uniform(0, 2 * np.pi)
    for number in range(count):
        share = (number + 0.5) / count
        # Widest a bit below the middle; each ball a golden angle further round.
        out = wide * (0.25 if slim else 0.5) * np.sin(np.pi * min(share + 0.15, 1.0))
        angle = turn + number * 2.4
        size = (2 * wide - 2 * out) * rng.uniform(0.85, 1.0)
        height = tall * (0.55 if fine else 0.7) * rng.uniform(0.85, 1.0)
        middle = low + height / 2 + share * (tall - height)
        x, y = float(out * np.cos(angle)), float(out * np.sin(angle))
        ball = mesh.ellipsoid(
            (size, size, height), (x, y, middle), shades[number % 2], sides=10 if fine else 6
        )
        parts.append(rough(ball, rng))
        if fine:
            start = (0.0, 0.0, float(low - 0.5 + 0.3 * share * tall))
            parts.append(mesh.tube(start, (x, y, middle), radius * 0.4, bark, sides=5))
    return mesh.merge(parts)


def _conifer(rng: np.random.Generator, leaves: Finish, fine: bool) -> Mesh:
    tall, wide = rng.uniform(6.0, 11.0), rng.uniform(1.4, 2.2)
    parts = [mesh.tube((0.0, 0.0, -0.3), (0.0, 0.0, 1.6), 0.17, BARK, sides=8)]
    count = 5 if fine else 2
    bottoms = np.linspace(0.7, tall * 0.72, count)
    for number, bottom in enumerate(bottoms):
        reach = wide * (1.0 - 0.75 * number / count)
        end = min(bottom + tall * 1.7 / (count + 1), tall)
        cone = mesh.tube(
            (0.0, 0.0, float(bottom)),
            (0.0, 0.0, float(end)),
            reach,
            leaves,
            end_radius_m=0.05,
            sides=11 if fine else 7,
        )
        parts.append(rough(cone, rng))
    return mesh.merge(parts)


def _hedge(places_m: Array, rng: np.random.Generator) -> Mesh:
    """Return a rounded bank of leaves."""
    height, half = rng.uniform(0.9, 1.9), rng.uniform(0.22, 0.3)
    steps = np.gradient(np.asarray(places_m), axis=0)[:, :2]
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    left = np.column_stack([-steps[:, 1], steps[:, 0], np.zeros(len(steps))])
    across = half * np.array([-0.9, -1.0, -1.0, -0.6, 0.0, 0.6, 1.0, 1.0, 0.9])
    up = height * np.array([-0.2, 0.3, 0.8, 0.97, 1.0, 0.97, 0.8, 0.3, -0.2])
    rings = places_m[:, None] + across[:, None] * left[:, None] + up[:, None] * np.array([0.0, 0.0, 1.0])
    rings[:, 1:-1] += rng.uniform(-0.05, 0.05, rings[:, 1:-1].shape)
    # Both ends close around a place below the ground, but for a hole of a few millimetres.
    roots = (rings[0, [0, -1]].mean(axis=0), rings[-1, [0, -1]].mean(axis=0))
    ends = [0.01 * (ring - root) + root for ring, root in zip((rings[0], rings[-1]), roots, strict=True)]
    return mesh.sheet(np.concatenate([ends[:1], rings, ends[1:]]), tinted(LEAVES, rng, 14))


def _wall(length_m: float, rng: np.random.Generator) -> Mesh:
    """One panel of a wall, along x, with a coping."""
    surface = tinted((BRICK, PLASTER, CONCRETE)[rng.integers(3)], rng, 16)
    height, thick = rng.uniform(0.8, 1.9), 0.24
    return mesh.merge(
        [
            mesh.box((length_m, thick, height + 0.5), (0.0, 0.0, height / 2 - 0.25), surface),
            mesh.box((length_m, thick + 0.08, 0.07), (0.0, 0.0, height + 0.045), CONCRETE),
        ]
    )


def _fence(length_m: float, rng: np.random.Generator, fine: bool) -> Mesh:
    """One panel of a fence, along x: two posts with pickets on two rails, or with three rails."""
    surface = _FENCES[rng.integers(len(_FENCES))]
    height = rng.uniform(0.9, 1.5)
    pickets = fine and rng.random() < 0.7
    rails = (0.25, 0.85) if pickets else (0.3, 0.6, 0.9)
    parts = [
        mesh.box((0.1, 0.1, height + 0.5), (x, 0.0, height / 2 - 0.2), surface)
        for x in (0.06 - length_m / 2, length_m / 2 - 0.06)
    ]
    parts += [mesh.box((length_m, 0.04, 0.09), (0.0, 0.0, share * height), surface) for share in rails]
    if pickets:
        low = np.array([[x, -0.045, 0.05] for x in np.arange(-length_m / 2 + 0.14, length_m / 2 - 0.2, 0.2)])
        parts.append(blocks(low, low + np.array([0.09, 0.03, height - 0.05]), surface))
    return mesh.merge(parts)
