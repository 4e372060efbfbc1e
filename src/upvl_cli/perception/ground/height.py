"""Height above ground by a map of ground heights: lowest points, judged by their neighbors, then planes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from upvl_cli.perception.ground.config import GroundMapConfig
from upvl_cli.types import Array, Bools, Floats, Ints

MAX_HEIGHT_M = 1000.0  # heights are cut off here; half precision, in which they are stored, ends at 65504
RIDGE = 0.1  # of the spread of a full window, added to that of its cells: a bare line of cells has no tilt
RISE_ERROR = 0.2  # of a rise that the ridge and a slope seen in part leave uncertain
TINY = 1e-9  # keeps empty windows from dividing by nothing


class _Sweep(NamedTuple):
    """Points on the map: height, position (n, 2) in cells from its corner, and number of the cell.

    All points outside share the one number after the last cell.
    """

    z_m: Floats
    position: Floats
    cell: Ints
    size: int


class _Lowest(NamedTuple):
    """The lowest point of each cell, (size, size) each: height, infinite where none, and position in cells."""

    z_m: Array
    row: Array
    column: Array


def height_above_ground(xyz_ego_m: Floats, prior_z_m: float, config: GroundMapConfig) -> Floats:
    """Estimate the (n,) float32 height of each point above the ground below it, in metres, within 1 km.

    The lowest point of each cell is a candidate. Rejected are candidates that few neighbors agree with
    (mirror images under the road, objects without ground below), those above the lower envelope of slope
    `max_slope` (objects), and at first those in cells with an obstacle: a wall whose foot a car hides would
    be its own ground. The rest are smoothed by least squares planes, each in the smallest window that holds
    enough of them: kerbs stay sharp where the ground is dense, and far ground is found where it is sparse. Far windows
    are wide, and hold verges above the road: what lies a little above the planes is left out, and they sink to it.

    Args:
        xyz_ego_m: (n, 3) points.
        prior_z_m: Rough height of the road below the car, from where the sensor is mounted.
        config: The map and its rules.
    """
    if not len(xyz_ego_m):
        return np.zeros(0, np.float32)
    sweep = _project(xyz_ego_m, config)
    lowest = _lowest_points(sweep)
    low = _reject_implausible(lowest.z_m, prior_z_m, config)
    low[~_is_supported(low, config)] = np.inf
    lowest, known = lowest._replace(z_m=low), np.isfinite(low)
    # Unknown cells are infinite, and compare as no ground.
    is_ground = known & (low < _lower_envelope(low, config) + config.tolerance_m)
    is_ground &= ~_has_obstacle(sweep, low, config)
    for tolerance_m in (config.tolerance_m, *[config.refined_tolerance_m] * config.refinements):
        plane_m, rise_m = _fit_planes(lowest, is_ground, known, lowest.row, lowest.column, config)
        residual_m = low - plane_m
        # A slope that is seen on one side of a cell alone is uncertain by some share of its rise to there.
        margin_m = tolerance_m + (RISE_ERROR * np.abs(rise_m) if tolerance_m < config.tolerance_m else 0.0)
        is_ground = known & (residual_m < margin_m) & (residual_m > -config.max_depth_m)
    center = np.broadcast_to(np.arange(sweep.size) + 0.5, low.shape)
    ground_m, _ = _fit_planes(lowest, is_ground, _corner_cells(sweep), center.T, center, config)
    height_m = sweep.z_m - _interpolate(ground_m, sweep)
    return np.clip(height_m, -MAX_HEIGHT_M, MAX_HEIGHT_M).astype(np.float32)


def height_above_known_ground(
    xyz_ego_m: Floats, ground_z_m: Floats, prior_z_m: float, config: GroundMapConfig
) -> Floats:
    """Return the (n,) float32 height of each point above ground that is known, estimated where it is not.

    Args:
        xyz_ego_m: (n, 3) points.
        ground_z_m: (n,) height of the ground at each point; NaN where unknown.
        prior_z_m: Rough height of the road below the car, for the estimate.
        config: The map and its rules, for the estimate.
    """
    is_known = np.isfinite(ground_z_m)
    height_m = np.clip(xyz_ego_m[:, 2] - ground_z_m, -MAX_HEIGHT_M, MAX_HEIGHT_M).astype(np.float32)
    if not is_known.all():
        height_m[~is_known] = height_above_ground(xyz_ego_m, prior_z_m, config)[~is_known]
    return height_m


def _project(xyz_m: Floats, config: GroundMapConfig) -> _Sweep:
    size = round(2 * config.half_extent_m / config.cell_m)
    position = (xyz_m[:, :2].astype(np.float64) + config.half_extent_m) / config.cell_m
    row, column = np.floor(position).T
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    cell = np.where(inside, row * size + column, size * size).astype(np.int64)
    return _Sweep(xyz_m[:, 2].astype(np.float64), position, cell, size)


def _lowest_points(sweep: _Sweep) -> _Lowest:
    size = sweep.size
    low = np.full(size * size + 1, np.inf)
    np.minimum.at(low, sweep.cell, sweep.z_m)
    position = np.indices((size, size), dtype=np.float64).reshape(2, -1) + 0.5
    position = np.pad(position, ((0, 0), (0, 1)))
    at = np.flatnonzero(sweep.z_m == low[sweep.cell])
    position[:, sweep.cell[at]] = sweep.position[at].T
    low, row, column = (values[:-1].reshape(size, size) for values in (low, *position))
    return _Lowest(low, row, column)


def _reject_implausible(low: Array, prior_z_m: float, config: GroundMapConfig) -> Array:
    """Return the lowest points without those that no road can reach from the car, and with the prior below it."""
    center_m = (np.arange(len(low)) + 0.5) * config.cell_m - config.half_extent_m
    range_m = np.hypot(center_m[:, None], center_m)
    bound_m = config.prior_tolerance_m + config.prior_slope * range_m
    low = np.where(np.abs(low - prior_z_m) > bound_m, np.inf, low)
    return np.where((range_m < config.blind_radius_m) & ~np.isfinite(low), prior_z_m, low)


def _is_supported(low: Array, config: GroundMapConfig) -> Bools:
    """Return whether enough of the known neighbors lie within the tolerance and the slope of a lowest point."""
    known, agree, reach = np.zeros(low.shape), np.zeros(low.shape), config.support_radius_cells
    finite = np.isfinite(low)
    height = np.where(finite, low, np.nan)  # compared so, what is unknown never agrees
    pairs = zip(_neighbors(height, reach, np.nan), _neighbors(finite, reach, False), strict=True)
    for (distance, other), (_, is_known) in pairs:
        known += is_known
        agree += np.abs(other - height) <= config.tolerance_m + config.max_slope * distance * config.cell_m
    enough = (agree >= config.min_support_share * known) & (agree >= config.min_support_cells)
    return np.asarray(finite & enough)


def _lower_envelope(low: Array, config: GroundMapConfig) -> Array:
    """Return the highest surface below all lowest points that is nowhere steeper than the slope."""
    surface = low
    for _ in range(config.envelope_reach_cells):
        before = surface
        surface = before.copy()
        for distance, other in _neighbors(before, 1, np.inf):
            np.minimum(surface, other + config.max_slope * distance * config.cell_m, out=surface)
    return surface


def _neighbors(values: Array, reach: int, fill: float) -> Iterator[tuple[float, Array]]:
    """Yield, for each offset of at most `reach` cells, its length in cells and the map shifted by it."""
    padded = np.pad(values, reach, constant_values=fill)
    rows, columns = values.shape
    for down in range(2 * reach + 1):
        for right in range(2 * reach + 1):
            distance = float(np.hypot(down - reach, right - reach))
            yield distance, padded[down : down + rows, right : right + columns]


def _has_obstacle(sweep: _Sweep, low: Array, config: GroundMapConfig) -> Bools:
    """Return which cells have points a little above their lowest one."""
    above_m = sweep.z_m - np.append(low, np.inf)[sweep.cell]
    in_band = (above_m > config.obstacle_min_height_m) & (above_m < config.obstacle_max_height_m)
    return np.asarray(np.bincount(sweep.cell[in_band], minlength=low.size).reshape(low.shape) > 0)


def _fit_planes(
    lowest: _Lowest, is_ground: Bools, wanted: Bools, row: Array, column: Array, config: GroundMapConfig
) -> tuple[Array, Array]:
    """Return (size, size) heights, in each wanted cell, of the plane through the ground of its window; else 0.

    Beside it stands by how much of that the plane rises from the middle of the ground in its window.

    Args:
        lowest: The lowest points.
        is_ground: (size, size) which of them are ground.
        wanted: (size, size) the cells to evaluate.
        row: (size, size) position in each cell to evaluate the plane at, in cells.
        column: (size, size) the same along y.
        config: The windows.
    """
    middle = len(is_ground) / 2  # origin of the moments, so that squares stay small
    x, y = np.where(is_ground, lowest.row - middle, 0.0), np.where(is_ground, lowest.column - middle, 0.0)
    z = np.where(is_ground, lowest.z_m, 0.0)
    # Summed area tables: the sum over any window is four look-ups.
    area = np.zeros((len(z) + 1, len(z) + 1, 9))
    for moment, values in enumerate((is_ground, x, y, z, x * x, x * y, y * y, x * z, y * z)):
        area[1:, 1:, moment] = values
    np.cumsum(area, axis=0, out=area)
    np.cumsum(area, axis=1, out=area)
    reach = _window_reach(area[:, :, 0], config)[wanted]
    planes, rises = np.zeros(wanted.shape), np.zeros(wanted.shape)
    sums = _window_sums(area, np.stack(np.nonzero(wanted)), reach)
    planes[wanted], rises[wanted] = _plane_height(
        sums, 2 * reach + 1, row[wanted] - middle, column[wanted] - middle
    )
    return planes, rises


def _window_reach(count: Array, config: GroundMapConfig) -> Ints:
    """Return (size, size) cells to each side of a cell in its smallest window that holds enough ground."""
    size = len(count) - 1
    reaches = np.full((size, size), size, dtype=np.int64)
    cells = np.arange(size)
    for reach in (window // 2 for window in sorted(config.window_cells, reverse=True)):
        first, last = np.maximum(cells - reach, 0), np.minimum(cells + reach + 1, size)
        rows = count[last] - count[first]
        reaches[rows[:, last] - rows[:, first] > config.min_window_cells - 0.5] = reach
    return reaches


def _window_sums(area: Array, cells: Ints, reach: Ints) -> Array:
    """Return the (9, k) sums of the moments over the squares around k (2, k) cells."""
    size = len(area)
    (top, left), (bottom, right) = np.maximum(cells - reach, 0), np.minimum(cells + reach + 1, size - 1)
    flat = area.reshape(size * size, -1)
    a, b, c, d = (flat.take(x * size + y, axis=0) for x in (top, bottom) for y in (left, right))
    return np.ascontiguousarray((d - c - b + a).T)


def _plane_height(sums: Array, window: Ints, row: Array, column: Array) -> tuple[Array, Array]:
    """Return the (k,) height of the least squares plane of each window at a position, and its rise to there."""
    _, x, y, z, xx, xy, yy, xz, yz = sums / np.maximum(sums[0], TINY)
    ridge = RIDGE * window**2 / 12
    cxx, cyy, cxy = xx - x * x + ridge, yy - y * y + ridge, xy - x * y
    cxz, cyz = xz - x * z, yz - y * z
    determinant = cxx * cyy - cxy * cxy
    tilt_x = (cxz * cyy - cyz * cxy) / determinant
    tilt_y = (cyz * cxx - cxz * cxy) / determinant
    rise = tilt_x * (row - x) + tilt_y * (column - y)
    return z + rise, rise


def _corners(sweep: _Sweep) -> tuple[Ints, Floats]:
    """Return (n,) the first of the four cells whose centers surround each point, and (n, 2) how far past it."""
    position = np.clip(sweep.position - 0.5, 0, sweep.size - 1.001)
    first = position.astype(np.int64)
    return first[:, 0] * sweep.size + first[:, 1], position - first


def _corner_cells(sweep: _Sweep) -> Bools:
    """Return (size, size) which cells the height of some point depends on."""
    corner = np.zeros((sweep.size, sweep.size), dtype=np.bool_)
    corner.reshape(-1)[_corners(sweep)[0]] = True
    corner[1:] |= corner[:-1].copy()
    corner[:, 1:] |= corner[:, :-1].copy()
    return corner


def _interpolate(ground_m: Array, sweep: _Sweep) -> Array:
    """Return the (n,) height of the map at each point, bilinear between the centers of the cells."""
    corner, past = _corners(sweep)
    down, right = past.T
    flat, below = ground_m.reshape(-1), corner + sweep.size
    upper = flat.take(corner) * (1 - right) + flat.take(corner + 1) * right
    lower = flat.take(below) * (1 - right) + flat.take(below + 1) * right
    return np.asarray(upper * (1 - down) + lower * down)
