"""Where on the car a LiDAR sits: the place from which its beams are cones."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array, Floats

_LIMIT_DEG = 40.0  # elevations beyond are of points beside the car
_SMOOTH_DEG = 1.0  # a histogram over this is what it would be without beams
_FAR_SHARE = 0.3  # the farthest points, whose elevation hardly depends on the place
_X_M, _Y_M = np.arange(-1.5, 4.1, 0.25), np.arange(-1.0, 1.1, 1.0)
_HEIGHT_M, _MAX_HEIGHT_M, _HEIGHT_STEP_M = 0.4, 4.5, 0.05
_NEAR_M = 2.5  # nearer lies the car itself
_COARSE_DEG, _STARTS = 0.1, 3
_REFINE = (
    (0.1, 0.2),
    (0.1, 0.1),
    (0.1, 0.04),
    (0.05, 0.02),
    (0.05, 0.01),
)  # bins in degrees, steps in metres
_MAX_MOVES = 40


def elevations_deg(xyz_m: Array, origin_m: Array) -> Floats:
    """Return (n,) elevations of points in degrees, as seen from a place.

    Args:
        xyz_m: (n, 3) points.
        origin_m: (3,) the place, or (n, 3) one for each point.
    """
    ray = np.asarray(xyz_m, dtype=np.float64) - origin_m
    return np.asarray(np.degrees(np.arctan2(ray[:, 2], np.hypot(ray[:, 0], ray[:, 1]))))


def beam_contrast(elevation_deg: Floats, bin_deg: float) -> float:
    """Return how much more the elevations gather in narrow bins than in wide ones: 1 without beams.

    Args:
        elevation_deg: (n,) elevations.
        bin_deg: Width of the narrow bins.
    """
    inside = elevation_deg[np.abs(elevation_deg) < _LIMIT_DEG]
    if len(inside) < 2:
        return 1.0
    place = ((inside + _LIMIT_DEG) / bin_deg).astype(np.int64)
    count = np.bincount(place, minlength=int(2 * _LIMIT_DEG / bin_deg) + 1).astype(np.float64)
    half = max(1, round(_SMOOTH_DEG / bin_deg / 2))
    total = np.concatenate([np.zeros(half + 1), count.cumsum(), np.full(half, count.sum())])
    mean = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    # A point shares a bin with itself: that shows no beam.
    return float((count * (count - 1)).sum() / max((count * mean).sum() - len(inside) / (2 * half + 1), 1e-9))


def find_origin(xyz_m: Array, shift_m: Array, road_z_m: float, max_points: int) -> tuple[Floats, float]:
    """Return the place (3,) from which the beams are sharpest, and how sharp they are there.

    Args:
        xyz_m: (n, 3) points of one LiDAR and one sweep, in ego axes.
        shift_m: (n, 3) how far the car had moved when each was measured.
        road_z_m: Height of the road in ego axes; the LiDAR stands above it.
        max_points: How many of the points are looked at.
    """
    rays = np.asarray(xyz_m, dtype=np.float64) - shift_m
    distance_m = np.hypot(rays[:, 0], rays[:, 1])
    rays, distance_m = rays[distance_m > _NEAR_M], distance_m[distance_m > _NEAR_M]
    step = max(1, -(-len(rays) // max_points))
    rays, distance_m = rays[::step], distance_m[::step]
    if not len(rays):
        return np.zeros(3), 1.0
    far = rays[distance_m >= np.quantile(distance_m, 1 - _FAR_SHARE)]
    heights = np.arange(_HEIGHT_M, _MAX_HEIGHT_M, _HEIGHT_STEP_M) + road_z_m
    coarse = sorted(
        ((_contrast(far, np.array([1.0, 0.0, z]), _COARSE_DEG), z) for z in heights), reverse=True
    )
    starts = [np.zeros(3)] if -road_z_m >= _HEIGHT_M else []
    for _, z in coarse[:_STARTS]:
        places = [np.array([x, y, z]) for x in _X_M for y in _Y_M]
        starts.append(places[int(np.argmax([_contrast(rays, place, _COARSE_DEG) for place in places]))])
    found = []
    for start in starts:
        place: Floats = start
        for bin_deg, step_m in _REFINE:
            place = _climb(rays, place, bin_deg, step_m, road_z_m + _HEIGHT_M)
        found.append((_contrast(rays, place, _REFINE[-1][0]), *place))
    contrast, *best = max(found)
    return np.array(best), contrast


def _climb(rays: Floats, start: Floats, bin_deg: float, step_m: float, min_z_m: float) -> Floats:
    """Return the place that steps along the axes lead to, each to a higher contrast."""
    place, value = start, _contrast(rays, start, bin_deg)
    for _ in range(_MAX_MOVES):
        moves = [place + sign * step_m * axis for axis in np.eye(3) for sign in (-1, 1)]
        moves = [move for move in moves if move[2] >= min_z_m]
        values = [_contrast(rays, move, bin_deg) for move in moves]
        if max(values) <= value:
            break
        value, place = max(values), moves[int(np.argmax(values))]
    return place


def _contrast(rays: Floats, place: Floats, bin_deg: float) -> float:
    return beam_contrast(elevations_deg(rays, place), bin_deg)
