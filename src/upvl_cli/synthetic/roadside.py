"""What stands on the pavements between walkers and the roadway.

A thing's own axes: x along the traffic beside it, y away from the pavement towards the roadway.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic import mesh
from upvl_cli.synthetic.greenery import tinted, tree
from upvl_cli.synthetic.ground import END_M, REACH_M, START_M, near, spot
from upvl_cli.synthetic.mesh import Mesh
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import SIDE_HALF_M, Road
from upvl_cli.synthetic.surface import CONCRETE, DARK, GLASS, STEEL, WOOD, Finish, Rgb

_MIDDLE_M = 0.6  # behind the kerb
_LIGHT_M = 28.0  # between the street lights of one side
_STOP_M = 4.0  # kept free along the street around the middle of a bus stop
# Around the side street's middle: no things before (the crossing) and behind.
_FREE_M = (13.0, 8.0)

_RED, _AMBER, _GREEN = (214, 34, 34), (236, 168, 28), (40, 196, 92)
_WHITE, _BLUE, _YELLOW, _BLACK = (238, 238, 234), (28, 78, 168), (240, 196, 40), (30, 30, 32)
_BACK = STEEL._replace(rgb=(140, 142, 146))
# Sides of a plate (a triangle that stands on its tip is -3), its rim and its face.
_PLATES: tuple[tuple[int, Rgb, Rgb], ...] = (
    (20, _RED, _WHITE),
    (20, _WHITE, _BLUE),
    (20, _RED, _BLUE),
    (3, _RED, _WHITE),
    (-3, _RED, _WHITE),
    (4, _WHITE, _YELLOW),
)


def roadside(road: Road, rng: np.random.Generator) -> list[Piece]:
    """All things on the pavements, and trees far behind them."""
    pieces = [piece for side in (-1, 1) for piece in _strip(road, rng, side)]
    return [*pieces, *_traffic_lights(road, rng), *_far_trees(road, rng)]


def _strip(road: Road, rng: np.random.Generator, side: int) -> list[Piece]:
    """Along one side (1: left) of the street."""
    stop = float(rng.uniform(-12.0, 12.0) if side < 0 else rng.uniform(60.0, 85.0))
    pieces = [_put(road, side, stop, 0.95, Piece("bus stop", _bus_stop(rng)))]
    leafy = rng.uniform(0.35, 0.65)
    light = START_M + rng.uniform(3.0, _LIGHT_M)
    for slot in np.arange(START_M + 2.0, END_M - 2.0, 7.0):
        s = float(slot + rng.uniform(-1.8, 1.8))
        if abs(s - stop) < _STOP_M or -_FREE_M[0] < s - road.side_s_m < _FREE_M[1]:
            continue
        if s >= light:
            light += _LIGHT_M
            pieces.append(_put(road, side, s, _MIDDLE_M, Piece("street light", _street_light())))
        elif rng.random() < leafy:
            place = spot(road, s, side * (road.kerb_m + 0.75))
            pieces.append(tree(place, rng, street=True, fine=near(s)))
        else:
            pieces += [_put(road, side, s, _MIDDLE_M, piece) for piece in _small(rng)]
    return pieces


def _small(rng: np.random.Generator) -> list[Piece]:
    """Return a sign, a pole or nothing."""
    what = rng.random()
    if what < 0.45:
        return [Piece("traffic sign", _sign(rng))]
    return [Piece("pole", _pole(rng))] if what < 0.75 else []


def _put(road: Road, side: int, s_m: float, behind_m: float, piece: Piece) -> Piece:
    """Return a thing behind the kerb of one side (1: left), along its traffic."""
    place = spot(road, s_m, side * (road.kerb_m + behind_m))
    yaw = float(road.heading_rad(np.array(s_m))) + (np.pi if side > 0 else 0.0)
    return Piece(piece.name, piece.mesh.moved(place, yaw))


def _post(height_m: float, radius_m: float, surface: Finish, top_m: float | None = None) -> Mesh:
    return mesh.tube((0.0, 0.0, -0.3), (0.0, 0.0, height_m), radius_m, surface, end_radius_m=top_m)


def _street_light() -> Mesh:
    lamp = Finish((226, 224, 206), 0.5)
    return mesh.merge(
        [
            _post(1.0, 0.11, _BACK),
            _post(7.4, 0.085, _BACK, 0.05),
            mesh.tube((0.0, 0.0, 7.3), (0.0, 1.5, 7.75), 0.04, _BACK, sides=7),
            mesh.box((0.3, 0.8, 0.12), (0.0, 1.75, 7.78), _BACK),
            mesh.box((0.22, 0.6, 0.05), (0.0, 1.78, 7.7), lamp),
        ]
    )


def _pole(rng: np.random.Generator) -> Mesh:
    """Of wires, a steel post or a short bollard."""
    kind = rng.integers(3)
    if kind == 0:
        wood = tinted(WOOD, rng, 20)
        arm = mesh.box((0.12, 1.5, 0.12), (0.0, 0.0, 7.2), wood)
        pins = [mesh.tube((0.0, y, 7.25), (0.0, y, 7.45), 0.04, CONCRETE, sides=6) for y in (-0.6, 0.0, 0.6)]
        return mesh.merge([_post(7.9, 0.14, wood, 0.1), arm, *pins])
    if kind == 1:
        return _post(rng.uniform(2.5, 4.0), 0.05, _BACK)
    dark = tinted(DARK, rng, 20)
    top = mesh.ellipsoid((0.2, 0.2, 0.2), (0.0, 0.0, 0.95), dark, sides=8)
    return mesh.merge([_post(0.95, 0.08, dark), top])


def _face(rgb: Rgb) -> Finish:
    return Finish(rgb, 0.9, 0.0)


def _sign(rng: np.random.Generator) -> Mesh:
    """One or two plates, which look back at the traffic."""
    height = rng.uniform(2.3, 2.7)
    parts = [_post(height + 0.3, 0.035, _BACK)]
    if rng.random() < 0.25:
        parts += _panel(0.9, 0.6, height, rng)
    else:
        parts += _plate(*_PLATES[rng.integers(len(_PLATES))], height)
    if rng.random() < 0.3:
        parts += _panel(0.5, 0.3, height - 0.55, rng)
    return mesh.merge(parts)


def _plate(sides: int, rim: Rgb, face: Rgb, height_m: float) -> list[Mesh]:
    """Return a round or pointed plate before a post."""
    radius = 0.32 if sides == 20 else 0.42
    layers = ((0.04, 0.055, 1.0, _BACK), (0.05, 0.062, 0.98, _face(rim)), (0.055, 0.07, 0.72, _face(face)))
    parts = []
    for back, front, share, surface in layers:
        # A triangle's first corner points up where its tube runs along x.
        ends = (-front, -back) if sides == 3 else (-back, -front)
        start, end = ((x, 0.0, height_m) for x in ends)
        parts.append(mesh.tube(start, end, radius * share, surface, sides=abs(sides)))
    return parts


def _panel(width_m: float, height_m: float, middle_m: float, rng: np.random.Generator) -> list[Mesh]:
    """Return a rectangular plate before a post, with a mark on it."""
    ground, mark = ((_BLUE, _WHITE), (_WHITE, _BLACK), (_YELLOW, _BLACK))[rng.integers(3)]
    return [
        mesh.box((0.02, width_m, height_m), (-0.05, 0.0, middle_m), _BACK),
        mesh.box((0.02, width_m * 0.97, height_m * 0.96), (-0.06, 0.0, middle_m), _face(ground)),
        mesh.box((0.02, width_m * 0.6, height_m * 0.3), (-0.068, 0.0, middle_m), _face(mark)),
    ]


def _bus_stop(rng: np.random.Generator) -> Mesh:
    """Return a shelter open to the roadway, and the stop's sign."""
    frame = tinted(DARK, rng, 25)
    posts = [
        mesh.box((0.07, 0.07, 2.7), (x, y, 1.05), frame)
        for x in (-1.75, 0.0, 1.75)
        for y in (-0.5, 0.5)
        if x or y < 0
    ]
    sides = [mesh.box((0.02, 0.8, 1.9), (x, -0.05, 1.3), GLASS) for x in (-1.75, 1.75)]
    sign = [mesh.tube((2.6, 0.3, -0.3), (2.6, 0.3, 2.9), 0.035, _BACK)]
    sign += [part.moved((2.6, 0.3, 0.0)) for part in _plate(20, _GREEN, _YELLOW, 2.6)]
    return mesh.merge(
        [
            *posts,
            *sides,
            mesh.box((3.4, 0.02, 1.9), (0.0, -0.5, 1.3), GLASS),
            mesh.box((3.8, 1.3, 0.1), (0.0, 0.0, 2.45), frame),
            mesh.box((2.4, 0.35, 0.06), (0.0, -0.25, 0.48), WOOD),
            *(mesh.box((0.06, 0.25, 0.6), (x, -0.25, 0.15), frame) for x in (-0.9, 0.9)),
            *sign,
        ]
    )


def _traffic_lights(road: Road, rng: np.random.Generator) -> list[Piece]:
    """At the corners of the side street: green along the street, red for who comes from the side."""
    pieces = []
    away = SIDE_HALF_M + 1.0
    for side in (-1, 1):
        arm = road.lanes * 1.7 + rng.uniform(0.5, 1.5) if rng.random() < 0.5 else 0.0
        main = Piece("traffic light", _traffic_light(_GREEN, arm))
        pieces.append(_put(road, side, road.side_s_m + side * away, _MIDDLE_M, main))
        # It looks at the arm of the side street that ends here, whose traffic keeps right too.
        other = Piece("traffic light", _traffic_light(_RED, 0.0).moved((0.0, 0.0, 0.0), np.pi / 2))
        pieces.append(_put(road, side, road.side_s_m - side * away, _MIDDLE_M, other))
    return pieces


def _traffic_light(lit: Rgb, arm_m: float) -> Mesh:
    """Return a post with a box of three lights, and another one over the roadway where it has an arm."""
    boxes = [_lights(lit).moved((0.0, 0.0, 2.7))]
    post = _post(5.6 if arm_m else 3.2, 0.08, _BACK, 0.06)
    if not arm_m:
        return mesh.merge([post, *boxes])
    arm = mesh.tube((0.0, 0.0, 5.45), (0.0, arm_m, 5.7), 0.05, _BACK, sides=8)
    return mesh.merge([post, arm, *boxes, _lights(lit).moved((0.0, arm_m - 0.3, 5.6))])


def _lights(lit: Rgb) -> Mesh:
    """Return a dark box whose lights look back at the traffic."""
    parts = [mesh.box((0.18, 0.32, 0.95), (-0.17, 0.0, 0.0), DARK)]
    for rgb, height in ((_RED, 0.3), (_AMBER, 0.0), (_GREEN, -0.3)):
        red, green, blue = rgb
        shown: Rgb = rgb if rgb == lit else (red // 3, green // 3, blue // 3)
        parts.append(
            mesh.tube((-0.25, 0.0, height), (-0.275, 0.0, height), 0.11, Finish(shown, 0.3), sides=12)
        )
        hood = mesh.box((0.16, 0.26, 0.02), (-0.33, 0.0, height + 0.125), DARK)
        parts.append(hood)
    return mesh.merge(parts)


def _far_trees(road: Road, rng: np.random.Generator) -> list[Piece]:
    """Where the ground ends."""
    pieces = []
    for side in (-1, 1):
        for s in np.arange(START_M + 5.0, END_M - 5.0, 11.0) + rng.uniform(-3, 3, 39):
            if abs(s - road.side_s_m) > _FREE_M[1]:
                place = spot(road, s, side * rng.uniform(REACH_M - 8.0, REACH_M - 2.0))
                pieces.append(tree(place, rng, street=False, fine=False))
    return pieces
