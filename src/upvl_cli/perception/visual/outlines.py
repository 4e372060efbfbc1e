"""Where near surfaces end before far ones, as a camera sees the points of a sweep.

No dataset tells where its LiDAR sits, so the neighbours of a point are those in the view of the camera; the two
stand close together on all cars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Bools, Camera, Floats, ParallelArrays, array

LEFT, RIGHT, TOP = range(
    3
)  # where the far surface is; what is below a thing is mostly the ground it stands on
_NEIGHBOURS, _REACH = 28, 3.2  # samples around a point that are looked at, and how many steps away
_LEAST_POINTS = 200


@dataclass(frozen=True)
class Outlines(ParallelArrays):
    """Points where a near surface ends before a far one.

    Attributes:
        xyz_m: (n, 3) in the axes of the camera.
        side: (n,) where the far one is: 0 left, 1 right, 2 above.
        view: (n,) number of the view.
    """

    xyz_m: Array = array("float64", 3)
    side: Array = array("int64")
    view: Array = array("int64")


def joined(parts: Sequence[Outlines]) -> Outlines:
    """Return all of them, in the same order."""
    return Outlines(
        *(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Outlines))
    )


def outlines(camera: Camera, xyz_ego_m: Array, view: int) -> Outlines:
    """Return the outlines that a camera sees, each moved half a step out to where the surface may end.

    Args:
        camera: Its calibration need only be roughly right.
        xyz_ego_m: (n, 3) points.
        view: Number to note for them.
    """
    uv_px, _, visible = project(camera, xyz_ego_m)
    uv_px, xyz_m = uv_px[visible], apply(inverse(camera.ego_from_camera), xyz_ego_m[visible])
    if len(xyz_m) < _LEAST_POINTS:
        return Outlines(*(np.zeros(0) for _ in fields(Outlines)))
    step_px = _steps(uv_px)
    steps = uv_px / step_px
    _, other = cKDTree(steps).query(steps, k=_NEIGHBOURS)
    other = other[:, 1:]
    range_m = np.linalg.norm(xyz_m, axis=1)
    behind_m = range_m[other] - range_m[:, None]
    far = behind_m > np.maximum(0.5, 0.1 * range_m)[:, None]
    near = np.flatnonzero(far.any(axis=1))  # few: what follows looks at no others
    xyz_m, range_m, other, behind_m, far = xyz_m[near], range_m[near], other[near], behind_m[near], far[near]
    apart = steps[other] - steps[near, None]  # (near, neighbours, 2)
    same = np.abs(behind_m) < 0.2 + 0.03 * range_m[:, None]
    parts = []
    for side, axis, sign in ((LEFT, 0, -1), (RIGHT, 0, 1), (TOP, 1, -1)):
        along, across = apart[..., axis] * sign, np.abs(apart[..., 1 - axis])
        ends, out = _ends(along, across, far, same, side)
        moved = xyz_m[ends]
        shift_px = sign * step_px[axis] * out[ends]
        moved[:, axis] += shift_px * moved[:, 2] / camera.intrinsic[axis, axis]
        parts.append(Outlines(moved, np.full(len(moved), side), np.full(len(moved), view)))
    return joined(parts)


def _ends(along: Array, across: Array, far: Array, same: Array, side: int) -> tuple[Bools, Floats]:
    """(n,) whether a surface ends at each point towards a side, and how many steps farther out.

    Args:
        along: (n, k) steps to each neighbour towards the side.
        across: (n, k) steps to it across that.
        far: (n, k) whether it lies far behind.
        same: (n, k) whether it may lie on the same surface.
        side: Which one.
    """
    beyond = (across <= 0.7) & (along > 0.3) & (along < _REACH)
    held = (across <= 0.7) & (along < -0.3)
    if side != TOP:  # a pole is one column wide; a row of points on the ground is no outline, though
        held |= (np.abs(along) <= 0.7) & (across > 0.3)
    ends = np.any(beyond & far, axis=1) & ~np.any(beyond & ~far, axis=1) & np.any(held & same, axis=1)
    gap = np.where(beyond & far, along, np.inf).min(axis=1)
    # A wider gap is what the LiDAR does not see behind, and the camera does.
    return np.asarray(ends), np.where(gap < 1.6, gap / 2, 0.5)


def _steps(uv_px: Array) -> Floats:
    """(2,) distance between the columns of the LiDAR and between its rows, in the picture."""
    some = uv_px[:: max(1, len(uv_px) // 2000)]
    distance, other = cKDTree(uv_px).query(some, k=17)
    apart = uv_px[other[:, 1:]] - some[:, None]
    level = (apart[..., 0] > 0) & (np.abs(apart[..., 1]) < 0.35 * apart[..., 0])
    right = np.where(level, apart[..., 0], np.inf).min(axis=1)
    column_px = float(np.median(right[np.isfinite(right)])) if np.isfinite(right).any() else 1.0
    area_px = float(np.median(np.pi * distance[:, 16] ** 2 / 16))
    return np.array([column_px, max(column_px, area_px / column_px)])
