"""Lens distortion: where a lens puts the places of the plane at distance 1, and the slope of that.

Models: "brown", Brown and Conrady with radial k1, k2, k3 and tangential p1, p2 (D. C. Brown, Decentering
Distortion of Lenses, 1966); "fisheye", equidistant with k1 to k4 (Kannala and Brandt, A Generic Camera Model
and Calibration Method, 2006, as in OpenCV's fisheye module). Far outside the picture either polynomial can
turn back and lay points on pixels that they are not seen in; what lies beyond that turning point is not visible.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array, Camera, Floats

_REAL = 1e-12  # a root with a smaller imaginary part is real


def distort(camera: Camera, plane: Array) -> Floats:
    """Return (n, 2) where the lens puts the places of the plane at distance 1.

    Args:
        camera: Its distortion.
        plane: (n, 2) x / z, y / z in the axes of the camera.
    """
    plane = np.asarray(plane, dtype=np.float64)
    if camera.distortion_model == "fisheye":
        return np.asarray(plane * _fisheye_scale(camera, plane)[0][:, None])
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = plane.T
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    shifted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    shifted_y = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)
    return np.stack([shifted_x, shifted_y], axis=1)


def slope(camera: Camera, plane: Array) -> tuple[Floats, Floats, Floats]:
    """Return (n,) xx, xy and yy of the Jacobian of `distort`, which is symmetric.

    Args:
        camera: Its distortion.
        plane: (n, 2) x / z, y / z in the axes of the camera.
    """
    x, y = plane.T
    if camera.distortion_model == "fisheye":
        scale, growth = _fisheye_scale(camera, plane)
        return scale + x * x * growth, x * y * growth, scale + y * y * growth
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    growth = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
    xx = radial + x * x * growth + 2 * p1 * y + 6 * p2 * x
    yy = radial + y * y * growth + 2 * p2 * x + 6 * p1 * y
    xy = x * y * growth + 2 * p1 * x + 2 * p2 * y
    return xx, xy, yy


def turning_point(camera: Camera) -> float:
    """Return the squared radius in the plane from which on a larger angle no longer lands farther out."""
    if camera.distortion_model == "fisheye":
        k1, k2, k3, k4 = camera.distortion
        # The slope of theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).
        angle_rad = np.sqrt(_least_root([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1]))
        return float(np.tan(angle_rad) ** 2) if angle_rad < np.pi / 2 else np.inf
    k1, k2, _, _, k3 = camera.distortion
    return _least_root([7 * k3, 5 * k2, 3 * k1, 1])  # the slope of r (1 + k1 r^2 + k2 r^4 + k3 r^6)


def _least_root(coefficients: list[float]) -> float:
    """Return the least positive real root of a polynomial, highest power first; infinity where there is none."""
    roots = np.roots(coefficients)
    return float(roots.real[(np.abs(roots.imag) < _REAL) & (roots.real > 0)].min(initial=np.inf))


def _fisheye_scale(camera: Camera, plane: Array) -> tuple[Floats, Floats]:
    """Return (n,) distorted over undistorted radius s, and its growth (ds / dr) / r."""
    k1, k2, k3, k4 = camera.distortion
    radius = np.sqrt((plane * plane).sum(axis=1))
    angle = np.arctan(radius)
    a2 = angle * angle
    bent = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    bent_slope = (1 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4)))) / (1 + radius * radius)
    off_axis = radius > _REAL  # on the axis the scale is 1 and does not grow
    safe = np.where(off_axis, radius, 1.0)
    scale = np.where(off_axis, bent / safe, 1.0)
    return scale, np.where(off_axis, (bent_slope - scale) / (safe * safe), 0.0)
