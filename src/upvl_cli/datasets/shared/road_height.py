"""How far below the sensors the road is, measured: a start for the search of the ground."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array

# Around the car, where the road is flat; nearer lies the car itself.
_NEAR_M, _FAR_M = 2.5, 15.0
_SECTORS, _RINGS = 16, 5
_MIN_POINTS = 5  # of a patch of the road: fewer are noise
_LOW_PERCENT = 5  # of a patch: mirror images under the road are few
_DEFAULT_M = -1.7  # a sensor on the roof of a car, where a sweep has no near point


def road_height_m(xyz_ego_m: Array) -> float:
    """Return the height of the road below the car in ego axes, in metres.

    The plane around the car is cut into patches; the road is the median of the low points of those patches, the
    higher half of which (parked cars, walls, kerbs) is left out.

    Args:
        xyz_ego_m: (n, 3) points of one sweep, or of several.
    """
    xyz = np.asarray(xyz_ego_m, dtype=np.float64)
    radius = np.hypot(xyz[:, 0], xyz[:, 1])
    near = (radius > _NEAR_M) & (radius < _FAR_M) & np.isfinite(xyz[:, 2])
    xyz, radius = xyz[near], radius[near]
    sector = ((np.arctan2(xyz[:, 1], xyz[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    ring = ((radius - _NEAR_M) / (_FAR_M - _NEAR_M) * _RINGS).astype(int)
    patch = sector * _RINGS + ring
    lows = [
        np.percentile(xyz[patch == number, 2], _LOW_PERCENT)
        for number in np.flatnonzero(np.bincount(patch, minlength=1) >= _MIN_POINTS)
    ]
    if not lows:
        return _DEFAULT_M
    low = np.sort(lows)
    return float(np.median(low[: len(low) // 2 + 1]))
