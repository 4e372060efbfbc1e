"""The ground of the city: roadway, kerbs, pavements and grass, and what is painted on the roadway."""

from __future__ import annotations

import numpy as np

from upvl_cli.synthetic import mesh
from upvl_cli.synthetic.mesh import Mesh, Triple
from upvl_cli.synthetic.piece import Piece
from upvl_cli.synthetic.road import KERB_RUN_M, LANE_M, SIDE_HALF_M, Road
from upvl_cli.synthetic.surface import ASPHALT, GRASS, KERB, MARKING, PAVEMENT, Finish
from upvl_cli.types import Array, Floats, Ints

START_M, END_M = -165.0, 265.0  # s of the first and the last place with ground
REACH_M = 75.0  # |d| where the ground ends
SIDE_PAVEMENT_M = 3.0  # width of the side street's pavements
# S before the side street's kerb where people cross, first and last.
CROSSING_M = (6.0, 2.5)

_NEAR_S_M, _NEAR_M = 20.0, 90.0
_STEP_S_M, _STEP_D_M = 2.0, 6.0
_PAINT_M = 0.008  # height of paint above the roadway
_LINE_M = 0.14
_BAR_M = 0.5
# From the middle of a street outwards; the numbers are places in this tuple.
_ZONES: tuple[tuple[str, Finish], ...] = (
    ("road", ASPHALT),
    ("kerb", KERB),
    ("pavement", PAVEMENT),
    ("grass", GRASS),
)


def near(s_m: float) -> bool:
    """Whether what stands at s is worth many triangles."""
    return abs(s_m - _NEAR_S_M) < _NEAR_M


def spot(road: Road, s_m: float, d_m: float) -> Triple:
    """Return a single place on the ground."""
    x, y, z = (float(v) for v in road.place(np.array(s_m), np.array(d_m)))
    return x, y, z


def ground(road: Road) -> list[Piece]:
    """All ground of the city."""
    return [*_surfaces(road), Piece("lane marking", _markings(road)), Piece("crosswalk", _crossing(road))]


def _surfaces(road: Road) -> list[Piece]:
    edges_d = (road.kerb_m, road.kerb_m + KERB_RUN_M, road.front_m)
    edges_s = (SIDE_HALF_M, SIDE_HALF_M + KERB_RUN_M, SIDE_HALF_M + KERB_RUN_M + SIDE_PAVEMENT_M)
    breaks_s = road.side_s_m + np.array([*(-edge for edge in edges_s), *edges_s])
    breaks_d = np.array([*(-edge for edge in edges_d), *edges_d])
    s = _lines(np.array([START_M, *breaks_s, END_M]), _STEP_S_M)
    d = _lines(np.array([-REACH_M, *breaks_d, REACH_M]), _STEP_D_M)
    zone = np.minimum(
        _zone(s, road.side_s_m, edges_s)[:, None],
        _zone(d, 0.0, edges_d)[None, :],
    )
    places = road.place(s[:, None], d)
    pieces = []
    for number, (name, surface) in enumerate(_ZONES):
        carpet = mesh.sheet(places, surface)
        pieces.append(Piece(name, _kept(carpet, np.tile(zone.ravel() == number, 2))))
    return pieces


def _lines(breaks_m: Floats, step_m: float) -> Floats:
    """Grid lines at the breaks, and between them at most a step apart."""
    breaks = np.sort(breaks_m)
    counts = np.ceil(np.diff(breaks) / step_m).astype(int)
    parts = [
        np.linspace(first, last, count, endpoint=False)
        for first, last, count in zip(breaks[:-1], breaks[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, breaks[-1:]])


def _zone(lines_m: Floats, middle_m: float, edges_m: tuple[float, float, float]) -> Ints:
    """Which zone of a street lies between neighbouring lines."""
    away = np.abs((lines_m[1:] + lines_m[:-1]) / 2 - middle_m)
    return np.asarray(np.searchsorted(np.array(edges_m), away))


def _kept(carpet: Mesh, keep: Array) -> Mesh:
    """Return some faces of a mesh, with the corners they need."""
    used, face = np.unique(carpet.face[keep], return_inverse=True)
    return mesh.of(carpet.corner_m[used], face, carpet.surfaces[0])


def _painted(road: Road, s_m: tuple[float, float], d_m: tuple[float, float]) -> Mesh:
    """Paint over a stretch of the roadway."""
    s = _lines(np.array(s_m), _STEP_S_M)
    d = _lines(np.array(d_m), _STEP_D_M)
    return mesh.sheet(road.place(s[:, None], d) + np.array([0.0, 0.0, _PAINT_M]), MARKING)


def _markings(road: Road) -> Mesh:
    side = road.side_s_m
    stop_m = side - SIDE_HALF_M - CROSSING_M[0] - 1.5
    stretches = ((START_M, stop_m), (side + SIDE_HALF_M + 2.0, END_M))
    parts = [part for first, last in stretches for part in _along(road, first, last)]
    # Who comes along the street stops before the crossing; who comes towards it, before the side street.
    parts += [
        _painted(road, (stop_m, stop_m + _BAR_M), (-road.lanes * LANE_M + 0.2, -0.2)),
        _painted(road, (stretches[1][0] - _BAR_M, stretches[1][0]), (0.2, road.lanes * LANE_M - 0.2)),
    ]
    return mesh.merge([*parts, *_side_markings(road)])


def _along(road: Road, first_m: float, last_m: float) -> list[Mesh]:
    """Lines along the street between two s."""
    middles = (0.0,) if road.lanes == 1 else (-_LINE_M, _LINE_M)
    edge = road.lanes * LANE_M
    solid = [_painted(road, (first_m, last_m), _line(d)) for d in (*middles, -edge, edge)]
    dashes = [
        _painted(road, (s, s + 3.0), _line(sign * lane * LANE_M))
        for s in np.arange(first_m, last_m - 3.0, 9.0)
        for lane in range(1, road.lanes)
        for sign in (-1, 1)
    ]
    return solid + dashes


def _line(d_m: float) -> tuple[float, float]:
    return d_m - _LINE_M / 2, d_m + _LINE_M / 2


def _side_markings(road: Road) -> list[Mesh]:
    """Middle line and stop line of both arms of the side street, whose traffic keeps right too."""
    side = road.side_s_m
    near = road.kerb_m + 0.8
    parts = []
    for sign in (-1, 1):
        middle = (sign * near, sign * (REACH_M - 2.0))
        stop = (sign * near, sign * (near + _BAR_M))
        lane = (side - sign * 0.2, side - sign * (SIDE_HALF_M - 0.3))
        parts += [
            _painted(road, _line(side), (min(middle), max(middle))),
            _painted(road, (min(lane), max(lane)), (min(stop), max(stop))),
        ]
    return parts


def _crossing(road: Road) -> Mesh:
    """Bars along the street, from kerb to kerb."""
    first, last = (road.side_s_m - SIDE_HALF_M - away for away in CROSSING_M)
    starts = np.arange(-road.kerb_m + 0.35, road.kerb_m - _BAR_M - 0.1, 2 * _BAR_M)
    return mesh.merge(_painted(road, (first, last), (d, d + _BAR_M)) for d in starts)
