"""The ground below a sweep, as a map of heights: lowest points, judged by their neighbours, then planes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Bools, Floats, Ints

HALF_EXTENT_M = 80.0  # the map's reach; farther points take the height at its rim
NEAR_M = 2.5  # below the car itself nothing is seen: there the sensor's own height counts
START_TOLERANCE_M = 1.0  # a lowest point may lie this far from the flat ground at once,
START_SLOPE = 0.25  # and this much further with each metre of distance
NEIGHBOURS = 3  # cells to each side that judge a lowest point
MIN_SUPPORT = 0.3  # share of those that must agree with it
ENVELOPE_STEPS = 8  # cells over which ground is carried under objects
STANDING_M = (0.35, 1.0)  # points this far above the lowest are something that stands in the cell
WINDOWS = (5, 9, 17, 33, 65, 129)  # cells; the finest window that holds enough ground is taken
MIN_CELLS = 6  # ground cells that a window needs
BELOW_M = 0.5  # lower than the plane by more is a mirror image, not ground
MOST_M = 1000.0  # heights end here; half precision, in which they are kept, ends at 65504
EMPTY = 1e-9  # keeps empty windows from dividing by nothing


class _Sweep(NamedTuple):
    """Points on the map: height, place (n, 2) in cells from its corner, and number of the cell.

    All points outside share the one number after the last cell.
    """

    z_m: Floats
    place: Floats
    cell: Ints
    size: int


class _Lowest(NamedTuple):
    """The lowest point of each cell, (size, size) each: height, infinite where none, and place in cells."""

    z_m: Array
    row: Array
    column: Array


def height_above_ground(
    xyz_ego_m: Floats, *, start_z_m: float, cell_m: float, max_slope: float, tolerance_m: float
) -> Floats:
    """(n,) float32 height of each point above the ground below it, in metres, within 1 km.

    The lowest point of each cell is a candidate. Candidates that few neighbours agree with are mirror
    images under the road or things without ground below; those above a cone of `max_slope` from a
    lower neighbour are objects; those with something standing on them say nothing at first, or a wall
    seen above a car would be its own ground. The rest are smoothed by least squares planes, each in the
    finest window that holds enough of them: kerbs stay sharp where the ground is dense, and far ground
    is still found where it is sparse.

    Args:
        xyz_ego_m: (n, 3) points.
        start_z_m: Rough height of the road below the car.
        cell_m: Edge of the cells of the map.
        max_slope: Steepest ground, as rise over run.
        tolerance_m: Ground may lie this far above the envelope and above the planes.
    """
    if not len(xyz_ego_m):
        return np.zeros(0, np.float32)
    sweep = _on_map(xyz_ego_m, cell_m)
    lowest = _lowest(sweep)
    low = _plausible(lowest.z_m, start_z_m, cell_m)
    low[~_supported(low, cell_m, max_slope, tolerance_m)] = np.inf
    lowest, known = lowest._replace(z_m=low), np.isfinite(low)
    # What is unknown is infinite: compared so, it is never ground.
    is_ground = known & (low < _envelope(low, cell_m, max_slope) + tolerance_m) & ~_standing(sweep, low)
    above_m = low - _planes(lowest, is_ground, known, lowest.row, lowest.column)
    is_ground = known & (above_m < tolerance_m) & (above_m > -BELOW_M)
    middle = np.broadcast_to(np.arange(sweep.size) + 0.5, low.shape)
    ground = _planes(lowest, is_ground, _beside(sweep), middle.T, middle)
    height_m = sweep.z_m - _interpolated(ground, sweep)
    return np.clip(height_m, -MOST_M, MOST_M).astype(np.float32)


def _on_map(xyz_m: Floats, cell_m: float) -> _Sweep:
    size = round(2 * HALF_EXTENT_M / cell_m)
    place = (xyz_m[:, :2].astype(np.float64) + HALF_EXTENT_M) / cell_m
    row, column = np.floor(place).T
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    cell = np.where(inside, row * size + column, size * size).astype(np.int64)
    return _Sweep(xyz_m[:, 2].astype(np.float64), place, cell, size)


def _lowest(sweep: _Sweep) -> _Lowest:
    size = sweep.size
    low = np.full(size * size + 1, np.inf)
    np.minimum.at(low, sweep.cell, sweep.z_m)
    place = np.indices((size, size), dtype=np.float64).reshape(2, -1) + 0.5
    place = np.pad(place, ((0, 0), (0, 1)))
    at = np.flatnonzero(sweep.z_m == low[sweep.cell])
    place[:, sweep.cell[at]] = sweep.place[at].T
    low, row, column = (values[:-1].reshape(size, size) for values in (low, *place))
    return _Lowest(low, row, column)


def _plausible(low: Array, start_z_m: float, cell_m: float) -> Array:
    """The lowest points without those that no road could reach from the car."""
    centre_m = (np.arange(len(low)) + 0.5) * cell_m - HALF_EXTENT_M
    range_m = np.hypot(centre_m[:, None], centre_m)
    low = np.where(np.abs(low - start_z_m) > START_TOLERANCE_M + START_SLOPE * range_m, np.inf, low)
    return np.where((range_m < NEAR_M) & ~np.isfinite(low), start_z_m, low)


def _supported(low: Array, cell_m: float, max_slope: float, tolerance_m: float) -> Bools:
    """Whether enough of the known neighbours lie at about the same height."""
    known, agree = np.zeros(low.shape), np.zeros(low.shape)
    finite = np.isfinite(low)
    height = np.where(finite, low, np.nan)  # compared so, what is unknown never agrees
    pairs = zip(_shifted(height, NEIGHBOURS, np.nan), _shifted(finite, NEIGHBOURS, False), strict=True)
    for (distance, other), (_, there) in pairs:
        known += there
        agree += np.abs(other - height) <= tolerance_m + max_slope * distance * cell_m
    return np.asarray(finite & (agree >= MIN_SUPPORT * known) & (agree >= NEIGHBOURS))


def _envelope(low: Array, cell_m: float, max_slope: float) -> Array:
    """The highest surface below all lowest points that is nowhere steeper than the slope."""
    surface = low
    for _ in range(ENVELOPE_STEPS):
        before = surface
        surface = before.copy()
        for distance, other in _shifted(before, 1, np.inf):
            np.minimum(surface, other + max_slope * distance * cell_m, out=surface)
    return surface


def _shifted(values: Array, reach: int, fill: float) -> Iterator[tuple[float, Array]]:
    """The map seen from each neighbouring cell, and how many cells away that is."""
    padded = np.pad(values, reach, constant_values=fill)
    rows, columns = values.shape
    for down in range(2 * reach + 1):
        for right in range(2 * reach + 1):
            distance = float(np.hypot(down - reach, right - reach))
            yield distance, padded[down : down + rows, right : right + columns]


def _standing(sweep: _Sweep, low: Array) -> Bools:
    """Which cells have points a little above their lowest one."""
    above_m = sweep.z_m - np.append(low, np.inf)[sweep.cell]
    standing = sweep.cell[(above_m > STANDING_M[0]) & (above_m < STANDING_M[1])]
    return np.asarray(np.bincount(standing, minlength=low.size).reshape(low.shape) > 0)


def _planes(lowest: _Lowest, is_ground: Bools, wanted: Bools, row: Array, column: Array) -> Array:
    """(size, size) height at a place in each wanted cell of the plane through its window's ground; else 0."""
    middle = len(is_ground) / 2  # from there, so that squares stay small
    x, y = np.where(is_ground, lowest.row - middle, 0.0), np.where(is_ground, lowest.column - middle, 0.0)
    z = np.where(is_ground, lowest.z_m, 0.0)
    # Summed area tables: the sum over any window is four look-ups.
    area = np.zeros((len(z) + 1, len(z) + 1, 9))
    for moment, values in enumerate((is_ground, x, y, z, x * x, x * y, y * y, x * z, y * z)):
        area[1:, 1:, moment] = values
    np.cumsum(area, axis=0, out=area)
    np.cumsum(area, axis=1, out=area)
    reach = _reach(area[:, :, 0])[wanted]
    planes = np.zeros(wanted.shape)
    sums = _window_sums(area, np.stack(np.nonzero(wanted)), reach)
    planes[wanted] = _plane_at(sums, 2 * reach + 1, row[wanted] - middle, column[wanted] - middle)
    return planes


def _reach(count: Array) -> Ints:
    """(size, size) cells to each side of a cell in its finest window that holds enough ground."""
    size = len(count) - 1
    reaches = np.full((size, size), size, dtype=np.int64)
    cells = np.arange(size)
    for reach in (window // 2 for window in reversed(WINDOWS)):
        first, last = np.maximum(cells - reach, 0), np.minimum(cells + reach + 1, size)
        rows = count[last] - count[first]
        reaches[rows[:, last] - rows[:, first] > MIN_CELLS - 0.5] = reach
    return reaches


def _window_sums(area: Array, cells: Ints, reach: Ints) -> Array:
    """(9, k) sums of the moments over the squares around k (2, k) cells."""
    size = len(area)
    (top, left), (bottom, right) = np.maximum(cells - reach, 0), np.minimum(cells + reach + 1, size - 1)
    flat = area.reshape(size * size, -1)
    a, b, c, d = (flat.take(x * size + y, axis=0) for x in (top, bottom) for y in (left, right))
    return np.ascontiguousarray((d - c - b + a).T)


def _plane_at(sums: Array, window: Ints, row: Array, column: Array) -> Array:
    """Height of the least squares plane of each window at a place."""
    _, x, y, z, xx, xy, yy, xz, yz = sums / np.maximum(sums[0], EMPTY)
    ridge = 0.1 * window**2 / 12  # a tenth of a full window's spread: a bare line of cells has no tilt
    cxx, cyy, cxy = xx - x * x + ridge, yy - y * y + ridge, xy - x * y
    cxz, cyz = xz - x * z, yz - y * z
    determinant = cxx * cyy - cxy * cxy
    tilt_x = (cxz * cyy - cyz * cxy) / determinant
    tilt_y = (cyz * cxx - cxz * cxy) / determinant
    return np.asarray(z + tilt_x * (row - x) + tilt_y * (column - y))


def _corner(sweep: _Sweep) -> tuple[Ints, Floats]:
    """(n,) the first of the four cells whose centres surround each point, and (n, 2) how far past it."""
    place = np.clip(sweep.place - 0.5, 0, sweep.size - 1.001)
    first = place.astype(np.int64)
    return first[:, 0] * sweep.size + first[:, 1], place - first


def _beside(sweep: _Sweep) -> Bools:
    """(size, size) the cells that some point's height depends on."""
    corner = np.zeros((sweep.size, sweep.size), dtype=np.bool_)
    corner.reshape(-1)[_corner(sweep)[0]] = True
    corner[1:] |= corner[:-1].copy()
    corner[:, 1:] |= corner[:, :-1].copy()
    return corner


def _interpolated(ground: Array, sweep: _Sweep) -> Array:
    """(n,) height of the map at each point, bilinear between the centres of the cells."""
    corner, past = _corner(sweep)
    down, right = past.T
    flat, below = ground.reshape(-1), corner + sweep.size
    upper = flat.take(corner) * (1 - right) + flat.take(corner + 1) * right
    lower = flat.take(below) * (1 - right) + flat.take(below + 1) * right
    return np.asarray(upper * (1 - down) + lower * down)
