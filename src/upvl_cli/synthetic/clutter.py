"""What real streets have beside the road that is no road user: banks, wild growth, wire fences, stones, cabinets.

By the setting `clutter`. Along some stretches of each side the buildings give way to open land; elsewhere things
are added. Random numbers are its own: all else of the city stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from upvl_cli.synthetic import mesh, thicket
from upvl_cli.synthetic.greenery import blocks, rough, tinted
from upvl_cli.synthetic.ground import END_M, START_M, near, spot
from upvl_cli.synthetic.land import Stretch
from upvl_cli.synthetic.mesh import Mesh
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import SIDE_HALF_M, Road
from upvl_cli.synthetic.surface import BRICK, CONCRETE, GRASS, STEEL, WOOD, Finish
from upvl_cli.types import Array

_CLEARED_M = 32.0  # behind the pavement, so far the buildings of open land go
_CLEARED = ("building", "house", "wall", "fence", "hedge", "tree")
_STEP_M = 0.8
_GROUND = GRASS._replace(depth_m=0.02, dropout=0.05)
_MESH_M, _WIRE_M = 0.075, 0.006


def cleared(pieces: Sequence[Piece], road: Road, land: Sequence[Stretch]) -> list[Piece]:
    """Leave out the buildings, gardens and trees that stand on open land."""
    kept = []
    for piece in pieces:
        if piece.name in _CLEARED and len(piece.mesh.corner_m):
            s, d = road.coordinates(piece.mesh.corner_m[:, :2].mean(axis=0, keepdims=True))
            behind = float(np.abs(d[0])) - road.front_m
            side = 1 if d[0] > 0 else -1
            on = [one for one in land if one.side == side and one.first_m < s[0] < one.last_m]
            if on and -0.3 < behind < _CLEARED_M:
                continue
        kept.append(piece)
    return kept


def clutter_pieces(
    road: Road, land: Sequence[Stretch], rng: np.random.Generator, clutter: float
) -> list[Piece]:
    """All that is added."""
    pieces = [piece for stretch in land for piece in _on(road, stretch, rng)]
    for side in (-1, 1):
        pieces += _strip(road, side, rng, clutter)
        pieces += _gardens(road, [one for one in land if one.use == "car park"], side, rng, clutter)
    return pieces


def _on(road: Road, land: Stretch, rng: np.random.Generator) -> list[Piece]:
    """Return what is on a stretch of open land."""
    if land.use in ("bank", "cut"):
        return _bank(road, land, rng)
    if land.use == "thicket":
        return _bushes(road, land, rng, spacing_m=1.7, depth_m=5.0)
    if land.use == "hedge":
        return [*_hedge_row(road, land, rng), *_bushes(road, land, rng, spacing_m=9.0, depth_m=7.0)]
    pieces = [_wire_fence(road, land, rng)] if rng.random() < 0.7 else []
    if land.use == "meadow":
        pieces += [*_grass(road, land, rng), *_bushes(road, land, rng, spacing_m=7.0, depth_m=9.0)]
    return pieces


def _bank(road: Road, land: Stretch, rng: np.random.Generator) -> list[Piece]:
    """Ground that rises behind the pavement, above a low wall where it is a cut, with growth on it."""
    height, slope = rng.uniform(0.5, 2.8), rng.uniform(0.35, 1.1)
    start, pieces, wall = road.front_m + rng.uniform(0.15, 1.2), [], 0.0
    if land.use == "cut":
        wall = rng.uniform(0.4, 1.2)
        pieces.append(_retaining_wall(road, land, start, wall, rng))
        start += 0.25
    run = height / slope
    ends = min(4.0, (land.last_m - land.first_m) / 3)
    s = np.arange(land.first_m, land.last_m + _STEP_M / 2, _STEP_M)
    d = start + np.concatenate([[0.0], np.linspace(0, run, max(int(run / 0.6), 3)), [run + 5.0, run + 9.0]])
    rise = wall + height * np.clip((d - start) / run, 0, 1)
    rise[0], rise[-1] = -0.3, -0.3  # below the ground on both sides
    fade = np.clip(np.minimum(s - land.first_m, land.last_m - s) / ends, 0.0, 1.0)
    up = np.where(rise > 0, rise * fade[:, None], rise) + rng.normal(0, 0.03, (len(s), len(d))) * (rise > 0)
    places = road.place(s[:, None], land.side * d) + up[..., None] * np.array([0.0, 0.0, 1.0])
    order = 1 if land.side > 0 else -1  # so that its front looks up
    pieces.append(Piece("grass", mesh.sheet(places[:, ::order], tinted(_GROUND, rng, 20))))
    growth = rng.uniform(0, 1)
    inner = np.argwhere((rise > 0)[None, :] & (fade > 0.3)[:, None])
    if len(inner) and growth > 0.25:
        picked = inner[rng.integers(len(inner), size=int(growth * len(s)))]
        spots = places[picked[:, 0], picked[:, 1]]
        pieces += [_grown(place, rng, near(land.first_m)) for place in spots[: len(spots) // 3]]
        pieces.append(Piece("grass", thicket.tufts(spots, rng)))
    return pieces


def _retaining_wall(
    road: Road, land: Stretch, start_m: float, height_m: float, rng: np.random.Generator
) -> Piece:
    surface = tinted((BRICK, CONCRETE, CONCRETE)[rng.integers(3)], rng, 16)
    parts = _along(
        road,
        land,
        start_m,
        2.4,
        lambda length: mesh.box((length, 0.3, height_m + 0.5), (0, 0, height_m / 2 - 0.25), surface),
    )
    return Piece("wall", mesh.merge(parts))


def _along(
    road: Road, land: Stretch, d_m: float, step_m: float, panel: Callable[[float], Mesh]
) -> list[Mesh]:
    """Panels one after the other along the street at |d|; each is made for its length."""
    count = max(round((land.last_m - land.first_m) / step_m), 1)
    places = road.place(np.linspace(land.first_m, land.last_m, count + 1), np.array(land.side * d_m))
    steps = np.diff(places, axis=0)
    middles, yaws = (places[1:] + places[:-1]) / 2, np.arctan2(steps[:, 1], steps[:, 0])
    lengths = np.linalg.norm(steps, axis=1)
    return [
        panel(float(length)).moved((x, y, z), float(yaw))
        for length, (x, y, z), yaw in zip(lengths, middles.tolist(), yaws, strict=True)
    ]


def _bushes(
    road: Road, land: Stretch, rng: np.random.Generator, *, spacing_m: float, depth_m: float
) -> list[Piece]:
    """Bushes at any distance behind the pavement."""
    count = int((land.last_m - land.first_m) / spacing_m)
    found = []
    for s in rng.uniform(land.first_m + 0.8, land.last_m - 0.8, count):
        place = spot(road, float(s), land.side * (road.front_m + 0.9 + rng.uniform(0, depth_m)))
        found.append(_grown(np.array(place), rng, near(float(s))))
    return found


def _grown(place_m: Array, rng: np.random.Generator, fine: bool) -> Piece:
    """One bush, as small as a child's height or as large as a car."""
    x, y, z = (float(value) for value in place_m)
    length = float(np.exp(rng.uniform(np.log(0.6), np.log(4.5))))
    width = min(length * rng.uniform(0.6, 1.0), 2.4)
    size = (length, width, rng.uniform(0.5, 1.2) + 0.25 * width)
    return Piece("hedge", thicket.bush(size, rng, fine=fine).moved((x, y, z), rng.uniform(0, 2 * np.pi)))


def _hedge_row(road: Road, land: Stretch, rng: np.random.Generator) -> list[Piece]:
    """Return a ragged hedge with gaps."""
    width, height = rng.uniform(0.5, 1.6), rng.uniform(0.7, 2.2)
    fine = near(land.first_m)
    parts = _along(
        road,
        land,
        road.front_m + 0.35 + width / 2,
        2.0,
        lambda length: thicket.hedge(length, width, height * rng.uniform(0.85, 1.15), rng, fine=fine),
    )
    kept = [part for part in parts if rng.random() > 0.12]
    return [Piece("hedge", mesh.merge(kept))] if kept else []


def _wire_fence(road: Road, land: Stretch, rng: np.random.Generator) -> Piece:
    """Return a fence of posts and a net of wires, between which rays pass."""
    height, fine = rng.uniform(0.9, 1.8), near(land.first_m)
    post = (STEEL, WOOD, CONCRETE)[rng.integers(3)]
    d = road.front_m + rng.uniform(0.2, 1.0)
    return Piece(
        "fence", mesh.merge(_along(road, land, d, 2.5, lambda length: _net(length, height, post, fine)))
    )


def _net(length_m: float, height_m: float, post: Finish, fine: bool) -> Mesh:
    """One panel of a wire fence, along x."""
    wire = STEEL._replace(rgb=(96, 116, 100), dropout=0.3)
    step = _MESH_M if fine else 4 * _MESH_M
    half = _WIRE_M / 2
    x = np.arange(-length_m / 2, length_m / 2, step)
    z = np.arange(0.08, height_m, step)
    upright = np.stack([x, 0 * x, 0 * x + height_m / 2], axis=1)
    level = np.stack([0 * z, 0 * z, z], axis=1)
    parts = [
        blocks(upright - [half, half, height_m / 2], upright + [half, half, height_m / 2], wire),
        blocks(level - [length_m / 2, half, half], level + [length_m / 2, half, half], wire),
        mesh.box((0.08, 0.08, height_m + 0.5), (-length_m / 2, 0.0, height_m / 2 - 0.2), post),
    ]
    return mesh.merge(parts)


def _grass(road: Road, land: Stretch, rng: np.random.Generator) -> list[Piece]:
    """Tall grass on a meadow."""
    count = int(4 * (land.last_m - land.first_m)) if near(land.first_m) else 0
    s, d = rng.uniform(land.first_m, land.last_m, count), road.front_m + rng.uniform(0.2, 9.0, count)
    return [Piece("grass", thicket.tufts(road.place(s, land.side * d), rng))] if count else []


def _strip(road: Road, side: int, rng: np.random.Generator, clutter: float) -> list[Piece]:
    """On the edge of the pavement at the kerb, where nobody walks: low growth, crash barriers, cabinets, stones."""
    found = []
    s = START_M + rng.uniform(0, 12)
    while s < END_M - 6.0:
        what, length = rng.random(), rng.uniform(1.2, 3.2)
        if abs(s - road.side_s_m) > SIDE_HALF_M + 9.0:
            yaw = float(road.heading_rad(np.array(s)))
            place = spot(road, float(s), side * (road.kerb_m + 0.65))
            if what < 0.45:
                grown = thicket.bush((length, 0.7, rng.uniform(0.4, 1.1)), rng, fine=near(s))
                found.append(Piece("hedge", grown.moved(place, yaw)))
            elif what < 0.6:
                land = Stretch(side, float(s), float(s + rng.uniform(6.0, 18.0)), "")
                if near(s) and abs(land.last_m - road.side_s_m) > SIDE_HALF_M + 9.0:
                    found.append(
                        Piece("fence", mesh.merge(_along(road, land, road.kerb_m + 0.35, 2.0, _barrier)))
                    )
                s = land.last_m
            elif what < 0.75:
                behind = spot(road, float(s), side * (road.front_m + 0.1))
                found.append(Piece("wall", _cabinet(rng).moved(behind, yaw)))
            else:
                found.append(Piece("wall", _stone(rng).moved(place, yaw)))
        s += rng.uniform(6.0, 18.0) / max(clutter, 0.1)
    return found


def _gardens(
    road: Road, parks: Sequence[Stretch], side: int, rng: np.random.Generator, clutter: float
) -> list[Piece]:
    """Bushes and stones behind the pavement, before walls and in yards too, but not among parked cars."""
    found = []
    for s in rng.uniform(START_M, END_M, round(clutter * (END_M - START_M) / 3.0)):
        parked = any(one.side == side and one.first_m - 3 < s < one.last_m + 3 for one in parks)
        if parked or abs(s - road.side_s_m) < SIDE_HALF_M + 5.0:
            continue
        place = spot(road, float(s), side * (road.front_m + 0.3 + rng.exponential(1.5)))
        if rng.random() < 0.85:
            found.append(_grown(np.array(place), rng, near(s)))
        else:
            found.append(Piece("wall", _stone(rng).moved(place)))
    return found


def _barrier(length_m: float) -> Mesh:
    """One panel of a crash barrier, along x."""
    rail = mesh.box((length_m, 0.08, 0.31), (0.0, 0.0, 0.6), STEEL)
    return mesh.merge([rail, mesh.box((0.1, 0.12, 1.1), (0.0, 0.0, 0.2), STEEL)])


def _cabinet(rng: np.random.Generator) -> Mesh:
    """Of electricity or telephones."""
    size = (rng.uniform(0.6, 2.0), rng.uniform(0.3, 0.5), rng.uniform(0.9, 1.6))
    return mesh.box(size, (0.0, 0.0, size[2] / 2), tinted(CONCRETE, rng, 30))


def _stone(rng: np.random.Generator) -> Mesh:
    length = rng.uniform(0.3, 1.1)
    size = (length, length * rng.uniform(0.5, 0.9), length * rng.uniform(0.5, 1.0))
    return rough(mesh.ellipsoid(size, (0.0, 0.0, 0.3 * size[2]), tinted(CONCRETE, rng, 25), sides=8), rng)
