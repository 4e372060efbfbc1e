"""The pinhole camera with lens distortion (`geometry.lens`): from points to pixels, and from pixels to rays."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.lens import distort, slope, turning_point
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Bools, Camera, Floats

_NEWTON_STEPS = 20  # each doubles the right digits; a pixel that needs more has no ray
_NEGLIGIBLE_STEP = 1e-13  # of the focal length: a smaller Newton step changes no digit that matters
_CONVERGED = 1e-9  # of the focal length: a millionth of a pixel


def project(camera: Camera, xyz_ego_m: Array) -> tuple[Floats, Floats, Bools]:
    """Return where points appear: (n, 2) pixels, (n,) depth in metres, (n,) whether they are in the image.

    Depth is along the view. Pixels are NaN for points behind the camera and beyond the lens's reach;
    a point hidden behind another one counts as in the image.

    Args:
        camera: Where it is and how it sees; the image spans -0.5 to width - 0.5, and so downwards.
        xyz_ego_m: (n, 3) points.
    """
    xyz = apply(inverse(camera.ego_from_camera), np.asarray(xyz_ego_m).reshape(-1, 3))
    depth_m = xyz[:, 2]
    reached = np.flatnonzero(depth_m > 0)  # of a sweep all around most lies elsewhere
    with np.errstate(over="ignore"):  # a point just in front of the lens lies infinitely far out
        plane = xyz[reached, :2] / depth_m[reached, None]
        near = np.einsum("nk,nk->n", plane, plane) < turning_point(camera)
    reached, plane = reached[near], plane[near]
    uv_px = np.full((len(xyz), 2), np.nan)
    uv_px[reached] = distort(camera, plane) @ camera.intrinsic[:2, :2].T + camera.intrinsic[:2, 2]
    u_px, v_px = uv_px.T
    wide = (u_px >= -0.5) & (u_px < camera.width_px - 0.5)
    return uv_px, depth_m, wide & (v_px >= -0.5) & (v_px < camera.height_px - 0.5)


def rays(camera: Camera, uv_px: Array) -> Floats:
    """Return (n, 3) unit directions in ego axes from the camera through pixels; NaN where no ray arrives.

    Args:
        camera: Where it is and how it sees.
        uv_px: (n, 2) pixels; (0, 0) is the centre of the first one.
    """
    uv_px = np.asarray(uv_px, dtype=np.float64).reshape(-1, 2)
    target = (uv_px - camera.intrinsic[:2, 2]) @ np.linalg.inv(camera.intrinsic[:2, :2]).T
    plane = target.copy()
    with np.errstate(all="ignore"):  # a pixel without a ray runs away and becomes NaN below
        for _ in range(_NEWTON_STEPS):
            step = _newton_step(camera, plane, distort(camera, plane) - target)
            plane -= step
            if not (np.abs(step) > _NEGLIGIBLE_STEP).any():
                break
        missed = np.abs(distort(camera, plane) - target).max(axis=1, initial=0)
        arrives = (missed < _CONVERGED) & ((plane * plane).sum(axis=1) < turning_point(camera))
    plane[~arrives] = np.nan
    direction = np.concatenate([plane, np.ones((len(plane), 1))], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(direction @ camera.ego_from_camera[:3, :3].T)


def _newton_step(camera: Camera, plane: Array, residual: Array) -> Floats:
    """Return (n, 2) the inverse Jacobian of `distort` times the residual."""
    xx, xy, yy = slope(camera, plane)
    to_x = yy * residual[:, 0] - xy * residual[:, 1]
    to_y = xx * residual[:, 1] - xy * residual[:, 0]
    return np.asarray(np.stack([to_x, to_y], axis=1) / (xx * yy - xy * xy)[:, None])
