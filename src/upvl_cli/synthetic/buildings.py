"""Buildings along both streets, and what stands between and before them.

A building's own axes: its front lies in y = 0 and looks to -y, x along it, z = 0 the ground at its middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.synthetic import mesh
from upvl_cli.synthetic.greenery import blocks, bushes, edge, tinted, tree
from upvl_cli.synthetic.ground import END_M, START_M, near, spot
from upvl_cli.synthetic.mesh import Mesh, Triple
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import Road
from upvl_cli.synthetic.surface import BRICK, CONCRETE, GLASS, PLASTER, STEEL, TILES, WOOD, Finish
from upvl_cli.types import Array

_CORNER_M = 9.0  # between the side street's middle and the first building
_YARD_M = 42.0  # so far from the side street's middle, there are trees behind the first row
_SUNK_M = 1.2  # walls below the ground
_DEEPEST_M = 13.0
_SILL_M = 0.95
_PLASTERS = ((226, 222, 210), (214, 186, 128), (196, 150, 124), (158, 176, 186), (172, 184, 150))
_WALLS = (
    PLASTER,
    *(PLASTER._replace(rgb=rgb) for rgb in _PLASTERS),
    *(BRICK._replace(rgb=rgb) for rgb in ((152, 92, 74), (122, 74, 60), (176, 138, 106))),
    *(CONCRETE._replace(rgb=rgb) for rgb in ((160, 160, 154), (128, 132, 136))),
)
_ROOFS = (TILES, TILES._replace(rgb=(84, 82, 86), reflectance=0.2), TILES._replace(rgb=(112, 66, 48)))
_FRAMES = (
    Finish((232, 232, 228), 0.6),
    Finish((92, 70, 54), 0.3),
    Finish((66, 70, 76), 0.2),
)
_DOORS = (
    WOOD,
    Finish((66, 84, 72), 0.3),
    Finish((116, 40, 36), 0.3),
    Finish((60, 70, 96), 0.3),
)


class Lot(NamedTuple):
    """Where a building may stand.

    Attributes:
        place_m: Middle of its front on the ground.
        yaw_rad: Direction of its x.
        width_m: Room along the front.
        depth_m: How deep it is.
        near: Whether to spend triangles on it.
    """

    place_m: Triple
    yaw_rad: float
    width_m: float
    depth_m: float
    near: bool


class Facade(NamedTuple):
    """What the walls of one building have in common.

    Attributes:
        wall: What they are made of.
        frame: What goes around the windows.
        glass: What is in them.
        door: What the door is made of.
        floors: Storeys.
        floor_m: Height of each.
        pitch_m: Between the middles of neighbouring windows.
        window_m: Width and height of a window.
    """

    wall: Finish
    frame: Finish
    glass: Finish
    door: Finish
    floors: int
    floor_m: float
    pitch_m: float
    window_m: tuple[float, float]


def buildings(road: Road, rng: np.random.Generator) -> list[Piece]:
    """All buildings and their gardens."""
    pieces = []
    stretches = ((START_M, road.side_s_m - _CORNER_M), (road.side_s_m + _CORNER_M, END_M))
    for side in (-1, 1):
        for first, last in stretches:
            pieces += _front_row(road, rng, side, first, last)
            pieces += _back_row(road, rng, side, first, last)
        for arm in (-1, 1):
            pieces += _side_row(road, rng, side, arm)
    return pieces


def _front_row(road: Road, rng: np.random.Generator, side: int, first_m: float, last_m: float) -> list[Piece]:
    """Along one side (1: left) of the street."""
    pieces = []
    s, suburb = first_m, rng.random()
    while s < last_m - 8.0:
        small = rng.random() < suburb
        end = min(s + rng.uniform(9.0, 13.0) if small else s + rng.uniform(12.0, 22.0), last_m)
        setback = rng.uniform(2.5, 6.0) if small or rng.random() < 0.25 else 0.0
        lot = _lot(road, side, s, end, road.front_m + setback, _DEEPEST_M if not small else 10.0)
        pieces += _built(lot, rng, small)
        if setback and lot.width_m > 6.0:
            gate = (s + end) / 2
            pieces += [edge(road, rng, side, s, gate - 0.9), edge(road, rng, side, gate + 0.9, end)]
            pieces += bushes(road, rng, side, (s, end), road.front_m + setback - 0.9)
        gap = rng.uniform(0.4, 0.8) if not small and rng.random() < 0.4 else rng.uniform(2.5, 7.0)
        following = min(end + gap, last_m)
        if following - end > 2.0:
            pieces.append(edge(road, rng, side, end, following))
        if following - end > 5.0:
            place = spot(road, (end + following) / 2, side * (road.front_m + rng.uniform(4.0, 9.0)))
            pieces.append(tree(place, rng, street=True, fine=lot.near))
        if abs(s - road.side_s_m) > _YARD_M:
            behind = road.front_m + _DEEPEST_M + rng.uniform(9.0, 16.0)
            place = spot(road, rng.uniform(s, end), side * behind)
            pieces.append(tree(place, rng, street=False, fine=False))
        s = following
    return pieces


def _back_row(road: Road, rng: np.random.Generator, side: int, first_m: float, last_m: float) -> list[Piece]:
    """Behind the gardens, large and plain."""
    pieces = []
    s = first_m
    while s < last_m - 14.0:
        end = min(s + rng.uniform(14.0, 30.0), last_m)
        lot = _lot(road, side, s, end, rng.uniform(50.0, 53.0), 12.0)
        pieces += _built(lot._replace(near=False), rng, rng.random() < 0.2)
        following = end + rng.uniform(4.0, 16.0)
        if following - end > 8.0 and following < last_m:
            place = spot(road, (end + following) / 2, side * rng.uniform(46.0, 60.0))
            pieces.append(tree(place, rng, street=False, fine=False))
        s = following
    return pieces


def _side_row(road: Road, rng: np.random.Generator, side: int, arm: int) -> list[Piece]:
    """Along one side (1: far) of one arm (1: left) of the side street."""
    pieces = []
    d = road.front_m + _DEEPEST_M + 8.0
    s = road.side_s_m + side * (_CORNER_M + 0.5)
    while d < 40.0:
        end = min(d + rng.uniform(9.0, 13.0), 48.0)
        # The front looks at the side street: to lower s where it stands on its far side.
        yaw = float(road.heading_rad(np.array(s))) - side * np.pi / 2
        lot = Lot(spot(road, s, arm * (d + end) / 2), yaw, end - d - 0.5, 9.5, True)
        pieces += _built(lot, rng, rng.random() < 0.6)
        d = end + rng.uniform(2.0, 5.0)
    return pieces


def _lot(road: Road, side: int, first_m: float, last_m: float, d_m: float, depth_m: float) -> Lot:
    """Between two s, behind |d|; as wide as the street's bend lets it be."""
    rows = road.place(np.array([first_m, last_m]), side * np.array([[d_m], [d_m + depth_m]]))
    width = float(np.linalg.norm(rows[:, 1] - rows[:, 0], axis=1).min())
    middle = (first_m + last_m) / 2
    yaw = float(road.heading_rad(np.array(middle))) + (0.0 if side > 0 else np.pi)
    # Straight walls along a bend stand back by its rise.
    place = spot(road, middle, side * (d_m + 0.15 + width**2 / 8 * 0.009))
    return Lot(place, yaw, width, depth_m - 0.5, near(middle))


def _built(lot: Lot, rng: np.random.Generator, small: bool) -> list[Piece]:
    """Return a building on a lot; none where it is too narrow."""
    if lot.width_m < 6.0:
        return []
    name, form = ("house", _house) if small and lot.width_m < 15.0 else ("building", _block)
    return [Piece(name, form(lot, rng).moved(lot.place_m, lot.yaw_rad))]


def _block(lot: Lot, rng: np.random.Generator) -> Mesh:
    """Flats or offices under a flat roof."""
    floors = int(rng.integers(3, 7))
    facade = _facade(rng, floors, rng.uniform(2.8, 3.3), wide=rng.random() < 0.35)
    width, depth, height = lot.width_m - 0.3, lot.depth_m, floors * facade.floor_m + 0.7
    roof = height + 0.1
    parts = [
        _standing(width, depth, height, facade.wall),
        _standing(width, depth, 0.5, tinted(CONCRETE, rng, 30), 0.04),
        mesh.box((width + 0.2, depth + 0.2, 0.35), (0.0, depth / 2, roof), tinted(CONCRETE, rng, 45)),
        mesh.box((3.0, 3.0, 2.2), (rng.uniform(-2, 2), depth * 0.6, roof + 1.0), CONCRETE),
    ]
    parts += _openings(facade, width, lot.near, door=True)
    if lot.near:
        parts += _both_ends(facade, width, depth)
        if rng.random() < 0.5:
            parts += _balconies(facade, width, rng)
    return mesh.merge(parts)


def _house(lot: Lot, rng: np.random.Generator) -> Mesh:
    """Return a house under a pitched roof, whose gable looks to the street or to the sides."""
    floors = int(rng.integers(1, 3))
    facade = _facade(rng, floors, 2.7, wide=False)
    width, depth = min(lot.width_m - 1.2, 11.0), lot.depth_m - 1.0
    eaves = floors * facade.floor_m + 0.4
    gable = rng.random() < 0.5
    span, length = (width, depth) if gable else (depth, width)
    slope = rng.uniform(0.6, 1.0)
    parts = _gabled(span, length, eaves, slope, facade.wall, tinted(_ROOFS[rng.integers(3)], rng, 12))
    if gable:
        attic = np.array([[0.0, eaves + 0.2]])
        parts += [
            part.moved((0.0, -length / 2, 0.0)) for part in _windows(facade, attic, (1.0, 1.0), lot.near)
        ]
    turned = mesh.merge(parts).moved((0.0, depth / 2, 0.0), 0.0 if gable else np.pi / 2)
    plinth = _standing(width, depth, 0.35, tinted(CONCRETE, rng, 30), 0.04)
    openings = _openings(facade, width, lot.near, door=True)
    return mesh.merge([turned, plinth, *openings, *(_both_ends(facade, width, depth) if lot.near else [])])


def _gabled(
    span_m: float, length_m: float, eaves_m: float, slope: float, wall: Finish, roof: Finish
) -> list[Mesh]:
    """Walls, both sides of the roof and a chimney; the ridge along y."""
    half = span_m / 2
    ridge = eaves_m + half * slope
    outline = [(-half, -_SUNK_M), (half, -_SUNK_M), (half, eaves_m), (0.0, ridge), (-half, eaves_m)]
    out, low, thick = half + 0.4, eaves_m - 0.4 * slope + 0.03, 0.16
    right = [(0.0, ridge + 0.03), (out, low), (out, low + thick), (0.0, ridge + 0.03 + thick)]
    left = [(-x, z) for x, z in reversed(right)]
    return [
        mesh.prism(outline, length_m, wall),
        mesh.prism(right, length_m + 0.7, roof),
        mesh.prism(left, length_m + 0.7, roof),
        mesh.box((0.6, 0.6, 2.2), (half * 0.35, length_m * 0.22, ridge - 0.3), BRICK),
    ]


def _facade(rng: np.random.Generator, floors: int, floor_m: float, *, wide: bool) -> Facade:
    window = (rng.uniform(1.5, 2.2), 1.6) if wide else (rng.uniform(0.9, 1.5), rng.uniform(1.25, 1.5))
    wall, glass = tinted(_WALLS[rng.integers(len(_WALLS))], rng, 9), tinted(GLASS, rng, 14)
    frame, door = _FRAMES[rng.integers(len(_FRAMES))], _DOORS[rng.integers(len(_DOORS))]
    pitch = window[0] + rng.uniform(0.7, 1.5)
    return Facade(wall, frame, glass, door, floors, floor_m, pitch, window)


def _standing(width_m: float, depth_m: float, height_m: float, surface: Finish, out_m: float = 0.0) -> Mesh:
    """Walls from below the ground up, so far outside those of the building."""
    size = (width_m + 2 * out_m, depth_m + 2 * out_m, height_m + _SUNK_M)
    return mesh.box(size, (0.0, depth_m / 2, (height_m - _SUNK_M) / 2), surface)


def _openings(facade: Facade, width_m: float, near: bool, *, door: bool) -> list[Mesh]:
    """Windows, and a door in the middle, of a wall in y = 0."""
    columns = _columns(facade, width_m)
    count = len(columns)
    z = np.arange(facade.floors) * facade.floor_m + _SILL_M
    places = np.stack(np.meshgrid(columns, z), axis=-1).reshape(-1, 2)
    if not door or not count:
        return _windows(facade, places, facade.window_m, near)
    way = places[count // 2, 0]
    low, high = np.array([[way - 0.55, -0.08, -0.3]]), np.array([[way + 0.55, 0.05, 2.15]])
    canopy = blocks(low + [[-0.3, -0.7, 2.65]], high + [[0.3, 0.0, 0.3]], facade.frame)
    rest = np.delete(places, count // 2, axis=0)
    return [*_windows(facade, rest, facade.window_m, near), blocks(low, high, facade.door), canopy]


def _windows(facade: Facade, places_m: Array, size_m: tuple[float, float], near: bool) -> list[Mesh]:
    """Glass before a wall in y = 0, within frames where near; (n, 2) x and z of the middles of their sills."""
    x, z = places_m[:, 0], places_m[:, 1]
    half, height, still = size_m[0] / 2, size_m[1], np.zeros(len(x))
    low = np.column_stack([x - half, still - 0.03, z])
    high = np.column_stack([x + half, still + 0.05, z + height])
    glass = blocks(low, high, facade.glass)
    if not near:
        return [glass]
    around = np.array([0.09, -0.012, 0.09])
    return [glass, blocks(low - around, high + around * [1, 0, 1], facade.frame)]


def _both_ends(facade: Facade, width_m: float, depth_m: float) -> list[Mesh]:
    """Windows in the walls to the left and to the right."""
    wall = mesh.merge(_openings(facade, depth_m, True, door=False))
    return [wall.moved((side * width_m / 2, depth_m / 2, 0.0), side * np.pi / 2) for side in (-1, 1)]


def _columns(facade: Facade, width_m: float) -> Array:
    """X of the middles of the windows of one storey."""
    count = int((width_m - 0.9) / facade.pitch_m)
    return (np.arange(count) - (count - 1) / 2) * facade.pitch_m


def _balconies(facade: Facade, width_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Slabs with railings before some columns of windows, from the first floor up."""
    columns = _columns(facade, width_m)
    columns = columns[rng.random(len(columns)) < 0.4]
    x, z = np.meshgrid(columns, np.arange(1, facade.floors) * facade.floor_m)
    places = np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])
    half, out = facade.pitch_m / 2 - 0.1, 1.1
    railing = (STEEL, facade.glass, facade.wall)[rng.integers(3)]
    bars = (
        ((-half, -out, 0.0), (half, 0.05, 0.15), CONCRETE),
        ((-half + 0.02, -out + 0.02, 0.17), (half - 0.02, -out + 0.06, 1.15), railing),
        ((-half + 0.02, -out + 0.07, 0.17), (-half + 0.06, -0.01, 1.15), railing),
        ((half - 0.06, -out + 0.07, 0.17), (half - 0.02, -0.01, 1.15), railing),
    )
    return [blocks(places + low, places + high, surface) for low, high, surface in bars]
