"""The ground below a sweep, as a map of heights: lowest points, judged by their neighbours, then planes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from upvl_cli.types import Array, Bools, Floats, Ints

HALF_EXTENT_M = 80.0  # the map's reach; farther points take the height at its rim
NEAR_M = 2.5  # below the car itself nothing is seen: there the sensor's own height counts
START_TOLERANCE_M = 1.0  # a lowest point may lie this far from the flat ground at once,
START_SLOPE = 0.25  # and this much further with each metre of distance
NEIGHBOURS = 3  # cells to each side that judge a lowest point
MIN_SUPPORT = 0.3  # share of those that must agree with it
ENVELOPE_STEPS = 8  # cells over which ground is carried under objects
ROUNDS = 2  # refits of the planes without the cells that stand out
WINDOWS = (5, 9, 17, 33, 65, 129)  # cells; the finest window that holds enough ground is taken
MIN_CELLS = 6  # ground cells that a window needs
BELOW_M = 0.5  # lower than the plane by more is a mirror image, not ground
EMPTY = 1e-9  # keeps empty windows from dividing by nothing


def height_above_ground(
    xyz_ego_m: Floats, *, start_z_m: float, cell_m: float, max_slope: float, tolerance_m: float
) -> Floats:
    """(n,) float32 height of each point above the ground below it, in metres.

    The lowest point of each cell is a candidate. Candidates that few neighbours agree with are mirror
    images under the road or things without ground below; those above a cone of `max_slope` from a
    lower neighbour are objects. The rest are smoothed by weighted planes, in the finest window that
    holds enough of them, so that kerbs stay sharp where the ground is dense and far ground is still
    found where it is sparse.

    Args:
        xyz_ego_m: (n, 3) points.
        start_z_m: Rough height of the road below the car.
        cell_m: Edge of the cells of the map.
        max_slope: Steepest ground, as rise over run.
        tolerance_m: Ground may lie this far above the envelope and above the planes.
    """
    if not len(xyz_ego_m):
        return np.zeros(0, np.float32)
    size = round(2 * HALF_EXTENT_M / cell_m)
    low = _plausible(_lowest(xyz_ego_m, size, cell_m), start_z_m, cell_m)
    low[~_supported(low, cell_m, max_slope, tolerance_m)] = np.inf
    # What is unknown is infinite: compared so, it is never ground.
    is_ground = low < _envelope(low, cell_m, max_slope) + tolerance_m
    ground = _planes(low, is_ground & np.isfinite(low))
    for _ in range(ROUNDS):
        is_ground = (low < ground + tolerance_m) & (low > ground - BELOW_M)
        ground = _planes(low, is_ground)
    return (xyz_ego_m[:, 2] - _interpolated(ground, xyz_ego_m, cell_m)).astype(np.float32)


def _lowest(xyz_m: Floats, size: int, cell_m: float) -> Array:
    """(size, size) lowest z of each cell; infinite where it is empty."""
    cell = np.floor((xyz_m[:, :2] + HALF_EXTENT_M) / cell_m).astype(np.int64)
    inside = ((cell >= 0) & (cell < size)).all(axis=1)
    flat = cell[inside, 0] * size + cell[inside, 1]
    low = np.full(size * size, np.inf)
    np.minimum.at(low, flat, xyz_m[inside, 2].astype(np.float64))
    return low.reshape(size, size)


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
    height = np.where(finite, low, 0.0)
    pairs = zip(_shifted(height, NEIGHBOURS), _shifted(finite, NEIGHBOURS), strict=True)
    for (distance, other), (_, there) in pairs:
        known += there
        agree += there & (np.abs(other - height) <= tolerance_m + max_slope * distance * cell_m)
    return np.asarray(finite & (agree >= MIN_SUPPORT * known) & (agree >= NEIGHBOURS))


def _envelope(low: Array, cell_m: float, max_slope: float) -> Array:
    """The highest surface below all lowest points that is nowhere steeper than the slope."""
    surface = low
    for _ in range(ENVELOPE_STEPS):
        raised = [other + max_slope * distance * cell_m for distance, other in _shifted(surface, 1, np.inf)]
        surface = np.minimum.reduce(raised)
    return surface


def _shifted(values: Array, reach: int, fill: float = 0.0) -> Iterator[tuple[float, Array]]:
    """The map seen from each neighbouring cell, and how many cells away that is."""
    padded = np.pad(values, reach, constant_values=fill)
    rows, columns = values.shape
    for down in range(2 * reach + 1):
        for right in range(2 * reach + 1):
            distance = float(np.hypot(down - reach, right - reach))
            yield distance, padded[down : down + rows, right : right + columns]


def _planes(low: Array, is_ground: Bools) -> Array:
    """The map of heights: in each cell the plane through the ground cells of its window."""
    weight = is_ground.astype(np.float64)
    z = np.where(is_ground, low, 0.0)
    at = np.arange(len(low), dtype=np.float64) - len(low) / 2
    x, y = at[:, None] * weight, at * weight
    moments = np.stack([weight, x, y, z, x * at[:, None], x * at, y * at, z * at[:, None], z * at])
    # Summed area tables: the sum over any window is four look-ups.
    area = np.pad(moments, ((0, 0), (1, 0), (1, 0))).cumsum(axis=1).cumsum(axis=2)
    half = np.full(low.shape, len(low), dtype=np.int64)
    cells = np.arange(len(low))
    for reach in (window // 2 for window in reversed(WINDOWS)):
        first, last = np.maximum(cells - reach, 0), np.minimum(cells + reach + 1, len(low))
        rows = area[0, last] - area[0, first]
        half[rows[:, last] - rows[:, first] > MIN_CELLS - 0.5] = reach
    return _plane_at_centre(_window_sums(area, half), at, 2 * half + 1)


def _window_sums(area: Array, half: Ints) -> Array:
    """(k, size, size) sums of the k moments over the square of `half` cells to each side of a cell."""
    size = half.shape[0]
    cells = np.arange(size)
    first, last = np.maximum(cells[:, None] - half, 0), np.minimum(cells[:, None] + half + 1, size)
    left, right = np.maximum(cells - half, 0), np.minimum(cells + half + 1, size)
    flat = area.reshape(len(area), -1)
    corners = [(row * (size + 1) + column).ravel() for row in (first, last) for column in (left, right)]
    a, b, c, d = (flat.take(corner, axis=1) for corner in corners)
    return np.asarray((d - c - b + a).reshape(len(area), size, size))


def _plane_at_centre(sums: Array, at: Array, window: Ints) -> Array:
    """Height of the weighted least squares plane in the middle of each window."""
    _, x, y, z, xx, xy, yy, xz, yz = sums / np.maximum(sums[0], EMPTY)
    ridge = 0.1 * window**2 / 12  # a tenth of a full window's spread: a bare line of cells has no tilt
    cxx, cyy, cxy = xx - x * x + ridge, yy - y * y + ridge, xy - x * y
    cxz, cyz = xz - x * z, yz - y * z
    determinant = cxx * cyy - cxy * cxy
    tilt_x = (cxz * cyy - cyz * cxy) / determinant
    tilt_y = (cyz * cxx - cxz * cxy) / determinant
    return np.asarray(z + tilt_x * (at[:, None] - x) + tilt_y * (at - y))


def _interpolated(ground: Array, xyz_m: Floats, cell_m: float) -> Array:
    """(n,) height of the map at each point, bilinear between the centres of the cells."""
    place = (xyz_m[:, :2].astype(np.float64) + HALF_EXTENT_M) / cell_m - 0.5
    place = np.clip(place, 0, len(ground) - 1.001)
    row, column = np.floor(place).astype(np.int64).T
    down, right = (place - np.floor(place)).T
    upper = ground[row, column] * (1 - right) + ground[row, column + 1] * right
    lower = ground[row + 1, column] * (1 - right) + ground[row + 1, column + 1] * right
    return np.asarray(upper * (1 - down) + lower * down)
