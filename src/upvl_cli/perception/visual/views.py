"""Which camera sees which point: projection, occlusion, and the best of several cameras (UP-VL, Section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter1d

from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.perception.visual.config import VisibilityConfig
from upvl_cli.types import Array, Bools, Camera, Floats, Ints

SEEN, OCCLUDED, NO_VIEW = 0, 1, 2
NO_CAMERA = -1


class Visibility(NamedTuple):
    """How one camera sees the points of a sweep.

    Attributes:
        uv_px: (n, 2) pixel of each point; NaN for those behind the camera.
        state: (n,) `SEEN`, `OCCLUDED` or `NO_VIEW`.
        inset_px: (n,) distance to the picture's border; negative outside, -inf behind the camera.
    """

    uv_px: Floats
    state: Ints
    inset_px: Floats


def visibility(
    camera: Camera,
    xyz_ego_m: Array,
    is_above_ground: Bools,
    config: VisibilityConfig,
    given_px: Floats | None = None,
) -> Visibility:
    """Return which points of a sweep one camera sees.

    A point is occluded when closer surfaces enclose it: above and below, or left and right. So the far side of a
    car, which the LiDAR sees over its roof, is occluded, but the road in front of a car is not, though whatever
    lies below it in the picture is closer. A surface that is very much closer occludes from one side alone: its
    edge lies up to a beam beyond its last point, and the LiDAR, higher up than the camera, sees over it. And the
    ground far behind a raised surface is occluded for some height above that surface's points: the LiDAR sees it
    over the roof of a car, and through its windows (an addition to UP-VL, which does not treat occlusion).

    Args:
        camera: The camera.
        xyz_ego_m: (n, 3) points in ego axes at the time of the picture.
        is_above_ground: (n,) whether each point is above the ground.
        config: Limits of the test.
        given_px: (n, 2) pixels of the points as the data set gives them, NaN where the camera does not see one; None
            takes them from the calibration.
    """
    uv, depth_m, inside = project(camera, xyz_ego_m)
    if given_px is not None:
        uv, inside = given_px, ~np.isnan(given_px).any(axis=1) & (depth_m > 0)
    across, down = (
        np.minimum(pixel + 0.5, size - 0.5 - pixel)
        for pixel, size in zip(uv.T, (camera.width_px, camera.height_px), strict=True)
    )
    inset = np.minimum(across, down)
    inset[np.isnan(inset)] = -np.inf
    inside &= inset >= config.border_px
    state = np.full(len(uv), NO_VIEW, dtype=np.int8)
    state[inside] = SEEN
    occluded = _enclosed(uv[inside], depth_m[inside], camera.intrinsic[0, 0], config)
    occluded |= _behind_raised(
        uv[inside], depth_m[inside], is_above_ground[inside], camera.intrinsic[1, 1], config
    )
    state[np.flatnonzero(inside)[occluded]] = OCCLUDED
    return Visibility(uv, state, inset)


def _enclosed(uv_px: Floats, depth_m: Floats, focal_px: float, config: VisibilityConfig) -> Bools:
    """Return (n,) whether closer surfaces lie on both sides of a point, or a much closer one on one side.

    Args:
        uv_px: (n, 2) pixels.
        depth_m: (n,) depths.
        focal_px: Horizontal focal length.
        config: Limits of the test.
    """
    if not len(uv_px):
        return np.zeros(0, dtype=np.bool_)
    limit_m = depth_m - config.min_depth_gap_m - config.min_depth_gap_share * depth_m
    column, row = _cell(uv_px, config.cell_px)
    nearest = np.full((row.max() + 3, column.max() + 3), np.inf)
    np.minimum.at(nearest, (row, column), depth_m)
    reach = max(1, round(np.deg2rad(config.gap_deg) * focal_px / config.cell_px))
    occluded = np.zeros(len(row), dtype=np.bool_)
    for axis in (0, 1):
        # A beam is not quite level in the picture: its neighbors may lie a cell to the side.
        around = minimum_filter1d(nearest, 3, axis=1 - axis, mode="constant", cval=np.inf)
        sides = [
            _least_before(around, reach, axis),
            np.flip(_least_before(np.flip(around, axis), reach, axis), axis),
        ]
        closer = [side[row, column] for side in sides]
        occluded |= np.maximum(*closer) < limit_m
        occluded |= np.minimum(*closer) < config.one_sided_depth_share * depth_m
    return occluded


def _cell(uv_px: Floats, cell_px: float) -> tuple[Ints, Ints]:
    """Return column and row in the depth map, which has a rim of one cell."""
    column, row = ((uv_px + 0.5) / cell_px).astype(np.int64).T + 1
    return column, row


def _behind_raised(
    uv_px: Floats, depth_m: Floats, is_above_ground: Bools, focal_px: float, config: VisibilityConfig
) -> Bools:
    """Return (n,) whether a ground point appears on, or just above, a raised surface that is very much closer.

    Args:
        uv_px: (n, 2) pixels.
        depth_m: (n,) depths.
        is_above_ground: (n,) whether each point is above the ground.
        focal_px: Vertical focal length.
        config: Limits of the test.
    """
    if not is_above_ground.any():
        return np.zeros(len(uv_px), dtype=np.bool_)
    column, row = _cell(uv_px, config.cell_px)
    glass_px_m = config.glass_height_m * focal_px
    up = np.minimum(glass_px_m / depth_m / config.cell_px, row).astype(np.int64)
    raised = is_above_ground
    shape = (row.max() + 1, column.max() + 2)
    nearest = _nearest_upwards(row[raised], column[raised], up[raised], depth_m[raised], shape)
    nearest = minimum_filter1d(nearest, 3, axis=1, mode="constant", cval=np.inf)
    return np.asarray(~raised & (nearest[row, column] < config.one_sided_depth_share * depth_m))


def _nearest_upwards(row: Ints, column: Ints, up: Ints, depth_m: Floats, shape: tuple[int, int]) -> Floats:
    """Return the least depth in each cell over points that each cover their own row and `up` rows above it.

    Each covered range is two runs of a power of two rows, which may overlap; runs are halved until they are
    single cells (a sparse table). Cells that no point covers are infinite.
    """
    power = np.floor(np.log2(up + 1)).astype(np.int64)
    runs = np.full((power.max() + 1, *shape), np.inf)  # of rows from a cell downwards
    for first in (row - up, row - 2**power + 1):
        np.minimum.at(runs, (power, first, column), depth_m)
    for size in range(power.max(), 0, -1):
        half = 2 ** (size - 1)
        np.minimum(runs[size - 1], runs[size], out=runs[size - 1])
        np.minimum(runs[size - 1, half:], runs[size, :-half], out=runs[size - 1, half:])
    return np.asarray(runs[0])


def _least_before(nearest: Floats, reach: int, axis: int) -> Floats:
    """Return for each cell the least of the `reach` cells before it along an axis, without itself."""
    least = np.full_like(nearest, np.inf)
    for step in range(1, reach + 1):
        here, there = [slice(None)] * 2, [slice(None)] * 2
        here[axis], there[axis] = slice(step, None), slice(None, -step)
        least[tuple(here)] = np.minimum(least[tuple(here)], nearest[tuple(there)])
    return least


class CameraChoice(NamedTuple):
    """The best camera of each point.

    Attributes:
        state: (n,) `SEEN` by at least one camera, else `OCCLUDED` in at least one, else `NO_VIEW`.
        camera: (n,) number of the camera that sees the point best, `NO_CAMERA` where none does.
    """

    state: Ints
    camera: Ints


def best_camera(views: Sequence[Visibility], points: int) -> CameraChoice:
    """Return, of the cameras that see a point, the one in whose picture it lies farthest from the border.

    Args:
        views: One camera each.
        points: Number n of points.
    """
    if not views:
        return CameraChoice(np.full(points, NO_VIEW, np.int8), np.full(points, NO_CAMERA, np.int8))
    states = np.array([view.state for view in views])
    inset = np.where(states == SEEN, [view.inset_px for view in views], -np.inf)
    seen = (states == SEEN).any(axis=0)
    camera = np.where(seen, inset.argmax(axis=0), NO_CAMERA)
    return CameraChoice(states.min(axis=0).astype(np.int8), camera.astype(np.int8))


def move_to_time(
    xyz_ego_m: Array,
    velocity_mps: Array | None,
    delay_s: float,
    world_from_frame: Array,
    world_from_image: Array,
) -> Floats:
    """Return (n, 3) points of a sweep in the ego axes of the moment at which a picture was taken.

    Args:
        xyz_ego_m: (n, 3) points in ego axes at the time of the frame.
        velocity_mps: (n, 3) their motion over the ground in the same axes; None takes them as static.
        delay_s: How long after the frame the picture was taken.
        world_from_frame: (4, 4) pose of the frame.
        world_from_image: (4, 4) pose at the time of the picture.
    """
    moved = xyz_ego_m if velocity_mps is None else xyz_ego_m + velocity_mps * delay_s
    return np.asarray(apply(inverse(world_from_image) @ world_from_frame, moved))


def sample_bilinear(cells: Array, uv_px: Floats, width_px: int, height_px: int) -> Floats:
    """Return (n, d) features at pixels, interpolated between the centers of cells.

    Args:
        cells: (h', w', d) features that cover the picture evenly.
        uv_px: (n, 2) pixels.
        width_px: Width of the picture.
        height_px: Height of the picture.
    """
    high, wide = cells.shape[:2]
    x = np.clip((uv_px[:, 0] + 0.5) * wide / width_px - 0.5, 0, wide - 1)
    y = np.clip((uv_px[:, 1] + 0.5) * high / height_px - 0.5, 0, high - 1)
    left, top = (
        np.minimum(x.astype(np.int64), max(wide - 2, 0)),
        np.minimum(y.astype(np.int64), max(high - 2, 0)),
    )
    right, bottom = np.minimum(left + 1, wide - 1), np.minimum(top + 1, high - 1)
    across, down = ((x - left)[:, None]).astype(np.float32), ((y - top)[:, None]).astype(np.float32)
    upper = cells[top, left] * (1 - across) + cells[top, right] * across
    lower = cells[bottom, left] * (1 - across) + cells[bottom, right] * across
    return np.asarray(upper * (1 - down) + lower * down)
