"""How far below the sensors the road is, measured: a start for the search of the ground."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array

# Around the car, where the road is flat; nearer lies the car itself.
_NEAR_M, _FAR_M = 2.5, 15.0
_SECTORS, _RINGS = 16, 5
_MIN_POINTS = 5  # of a patch of the road: fewer are noise
_LOW_PERCENT = 5  # of a patch: mirror images under the road are few
_QUANTILE = (
    0.4  # of the patches lie below the plane: more are raised by kerbs and cars than lie below the road
)
_STEPS, _SHARP_M = 30, 0.01  # of the fit, which has settled then within a centimeter
_DEFAULT_M = -1.7  # a sensor on the roof of a car, where a sweep has no near point


def road_height_m(xyz_ego_m: Array) -> float:
    """Return the height of the road below the car in ego axes, in metres.

    The surroundings of the car are cut into patches. A plane is fitted to the low points of the patches by quantile
    regression, which parked cars and walls do not lift and slopes do not lower; the road is that plane at the car.

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
    count = np.bincount(patch, minlength=1)
    lows = []
    for number in np.flatnonzero(count >= _MIN_POINTS):
        inside = xyz[patch == number]
        lows.append([*inside[:, :2].mean(axis=0), np.percentile(inside[:, 2], _LOW_PERCENT)])
    return _plane_at_origin(np.array(lows)) if lows else _DEFAULT_M


def _plane_at_origin(lows: Array) -> float:
    """Return the height at the origin of the plane below which `_QUANTILE` of (n, 3) places lie."""
    basis = np.column_stack([np.ones(len(lows)), lows[:, :2] / _FAR_M])
    z = lows[:, 2]
    plane = np.array([np.quantile(z, _QUANTILE), 0.0, 0.0])
    if len(lows) < basis.shape[1]:
        return float(plane[0])
    for _ in range(_STEPS):  # iteratively reweighted least squares
        residual = z - basis @ plane
        weight = np.where(residual > 0, _QUANTILE, 1 - _QUANTILE) / np.maximum(np.abs(residual), _SHARP_M)
        weighted = basis * weight[:, None]
        # A little damping: patches on one line leave the tilt across it open.
        plane = np.linalg.solve(weighted.T @ basis + np.diag([0, 1e-3, 1e-3]), weighted.T @ z)
    return float(plane[0])
