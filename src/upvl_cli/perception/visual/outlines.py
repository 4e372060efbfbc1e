"""Where near surfaces end before far ones, as a camera sees the points of a sweep.

Datasets do not say where on the car the LiDAR is, so the neighbors of a point are those in the view of the camera;
the two stand close together on all cars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.perception.visual.config import OutlineConfig
from upvl_cli.types import Array, Bools, Camera, Floats, ParallelArrays, array, concat, empty

# Where the far surface is. Not below: what is below an object is mostly the ground that it stands on.
LEFT, RIGHT, TOP = range(3)
# Of a step between LiDAR samples: what is less far to the side lies in the same row or column (half a step, with
# room for rows that are not level in the picture), and what is nearer along it is the same sample.
_SAME_LINE, _NEXT = 0.7, 0.3
_ONE_STEP = 1.6  # steps; a wider gap lacks a sample
_SPACING_NEIGHBORS = 16  # samples that give the density around a point
_LEVEL_SLOPE = 0.35  # rise over run of a row of samples in the picture, at most


@dataclass(frozen=True)
class Outlines(ParallelArrays):
    """Points where a near surface ends before a far one.

    Attributes:
        xyz_m: (n, 3) in the axes of the camera.
        side: (n,) where the far surface is: 0 left, 1 right, 2 above.
        view: (n,) number of the picture.
        motion_mps: (n, 3) velocity of the point in the axes of the camera, if it stands and the car moves.
    """

    xyz_m: Array = array("float64", 3)
    side: Array = array("int64")
    view: Array = array("int64")
    motion_mps: Array = array("float64", 3)


def detect_outlines(camera: Camera, xyz_ego_m: Array, view: int, config: OutlineConfig) -> Outlines:
    """Return the outlines that a camera sees, each moved half a sample step out to where the surface may end.

    Depth discontinuities as in Levinson and Thrun (RSS 2013), Section III, but along both axes of the picture.

    Args:
        camera: Its calibration need only be roughly right.
        xyz_ego_m: (n, 3) points of a sweep.
        view: Number of the picture, for the result.
        config: Limits of the search.
    """
    uv_px, _, visible = project(camera, xyz_ego_m)
    uv_px, xyz_m = uv_px[visible], apply(inverse(camera.ego_from_camera), xyz_ego_m[visible])
    if len(xyz_m) < config.min_points:
        return empty(Outlines)
    spacing_px = _sample_spacing(uv_px)
    steps = uv_px / spacing_px
    _, neighbor = cKDTree(steps).query(steps, k=config.neighbors)
    neighbor = neighbor[:, 1:]
    range_m = np.linalg.norm(xyz_m, axis=1)
    behind_m = range_m[neighbor] - range_m[:, None]
    far = behind_m > np.maximum(config.min_range_gap_m, config.min_range_gap_share * range_m)[:, None]
    near = np.flatnonzero(far.any(axis=1))  # few: what follows needs no others
    xyz_m, range_m, neighbor, behind_m, far = (
        xyz_m[near],
        range_m[near],
        neighbor[near],
        behind_m[near],
        far[near],
    )
    apart = steps[neighbor] - steps[near, None]  # (near, neighbors, 2)
    same = np.abs(behind_m) < config.same_surface_m + config.same_surface_share * range_m[:, None]
    parts = []
    for side, axis, sign in ((LEFT, 0, -1), (RIGHT, 0, 1), (TOP, 1, -1)):
        along, across = apart[..., axis] * sign, np.abs(apart[..., 1 - axis])
        is_end, outward = _surface_ends(along, across, far, same, side=side, reach_steps=config.reach_steps)
        moved = xyz_m[is_end]
        shift_px = sign * spacing_px[axis] * outward[is_end]
        moved[:, axis] += shift_px * moved[:, 2] / camera.intrinsic[axis, axis]
        number = len(moved)
        parts.append(Outlines(moved, np.full(number, side), np.full(number, view), np.zeros((number, 3))))
    return concat(parts, Outlines)


def _surface_ends(
    along: Array, across: Array, far: Array, same: Array, *, side: int, reach_steps: float
) -> tuple[Bools, Floats]:
    """Return (n,) whether a surface ends at each point towards a side, and (n,) how many steps farther out.

    Args:
        along: (n, k) steps to each neighbor towards the side.
        across: (n, k) steps to it across that.
        far: (n, k) whether it lies far behind.
        same: (n, k) whether it may lie on the same surface.
        side: `LEFT`, `RIGHT` or `TOP`.
        reach_steps: How many steps beyond the point a far surface is looked for.
    """
    beyond = (across <= _SAME_LINE) & (along > _NEXT) & (along < reach_steps)
    inner = (across <= _SAME_LINE) & (along < -_NEXT)
    if side != TOP:  # a pole is one column wide; a row of points on the ground is no outline, though
        inner |= (np.abs(along) <= _SAME_LINE) & (across > _NEXT)
    is_end = np.any(beyond & far, axis=1) & ~np.any(beyond & ~far, axis=1) & np.any(inner & same, axis=1)
    gap = np.where(beyond & far, along, np.inf).min(axis=1)
    # A wider gap is background that the LiDAR does not see behind the surface, and the camera does.
    return np.asarray(is_end), np.where(gap < _ONE_STEP, gap / 2, 0.5)


def _sample_spacing(uv_px: Array) -> Floats:
    """Return (2,) median distance between the columns of the LiDAR and between its rows, in the picture."""
    sample = uv_px[:: max(1, len(uv_px) // 2000)]
    distance, neighbor = cKDTree(uv_px).query(sample, k=_SPACING_NEIGHBORS + 1)
    apart = uv_px[neighbor[:, 1:]] - sample[:, None]
    level = (apart[..., 0] > 0) & (np.abs(apart[..., 1]) < _LEVEL_SLOPE * apart[..., 0])
    right = np.where(level, apart[..., 0], np.inf).min(axis=1)
    column_px = float(np.median(right[np.isfinite(right)])) if np.isfinite(right).any() else 1.0
    area_px = float(np.median(np.pi * distance[:, _SPACING_NEIGHBORS] ** 2 / _SPACING_NEIGHBORS))
    return np.array([column_px, max(column_px, area_px / column_px)])
