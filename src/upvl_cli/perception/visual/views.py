"""Which camera sees which point: projection, what hides it, and the best of several views (UP-VL, Section 3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter1d

from upvl_cli.geometry.camera import project
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Bools, Camera, Floats, Ints

SEEN, OCCLUDED, NO_VIEW = 0, 1, 2
NO_CAMERA = -1
_CELL_PX = 2.0  # of the grid that holds the nearest depth
_FAR_CLOSER = 0.7  # of a point's depth: what is closer than that may hide it on one side alone


class View(NamedTuple):
    """How one camera sees the points of a sweep.

    Attributes:
        uv_px: (n, 2) where each appears; NaN for those behind the camera.
        state: (n,) `SEEN`, `OCCLUDED` or `NO_VIEW`.
        inset_px: (n,) how far inside of the picture's border; negative outside.
    """

    uv_px: Floats
    state: Ints
    inset_px: Floats


def view(
    camera: Camera,
    xyz_ego_m: Array,
    stands: Bools,
    *,
    border_px: float,
    gap_deg: float,
    closer_m: float,
    closer_share: float,
    glass_m: float,
) -> View:
    """See points through one camera.

    A point is hidden when surfaces that are closer surround it: above and below, or left and right. So the far
    side of a car, which the LiDAR looks at over its roof, is hidden, but the road before a car is not, though
    whatever lies below it in the picture is closer. Something very much closer hides on one side alone: its edge
    lies up to a beam beyond its last point, and the LiDAR, higher up, looks over it. And the ground behind what
    stands is hidden somewhat further up: the LiDAR sees it over the roof of a car, and through its windows.

    Args:
        camera: The camera.
        xyz_ego_m: (n, 3) points in ego axes at the time of the picture.
        stands: (n,) whether each is above the ground.
        border_px: Nearer than this to the picture's border a point counts as out of view.
        gap_deg: Points of one surface are not farther apart than this, as the camera sees them.
        closer_m: What hides a point is closer by this much,
        closer_share: and by this share of the point's depth.
        glass_m: What stands hides the ground for this much above its points.
    """
    uv, depth_m, inside = project(camera, xyz_ego_m)
    across, down = (
        np.minimum(place + 0.5, size - 0.5 - place)
        for place, size in zip(uv.T, (camera.width_px, camera.height_px), strict=True)
    )
    inset = np.minimum(across, down)
    inset[np.isnan(inset)] = -np.inf
    inside &= inset >= border_px
    state = np.full(len(uv), NO_VIEW, dtype=np.int8)
    state[inside] = SEEN
    gap_px = np.deg2rad(gap_deg) * camera.intrinsic[0, 0]
    limit_m = depth_m[inside] - closer_m - closer_share * depth_m[inside]
    hidden = _surrounded(uv[inside], depth_m[inside], limit_m, gap_px)
    hidden |= _behind(uv[inside], depth_m[inside], stands[inside], glass_m * camera.intrinsic[1, 1])
    state[np.flatnonzero(inside)[hidden]] = OCCLUDED
    return View(uv, state, inset)


def _surrounded(uv_px: Floats, depth_m: Floats, limit_m: Floats, gap_px: float) -> Bools:
    """(n,) whether there is something nearer than the limit on both sides of a point, in one of two directions."""
    if not len(uv_px):
        return np.zeros(0, dtype=np.bool_)
    column, row = _cell(uv_px)
    nearest = np.full((row.max() + 3, column.max() + 3), np.inf)
    np.minimum.at(nearest, (row, column), depth_m)
    reach = max(1, round(gap_px / _CELL_PX))
    hidden = np.zeros(len(row), dtype=np.bool_)
    for axis in (0, 1):
        # A beam is not quite level in the picture: its neighbours may lie a cell to the side.
        around = minimum_filter1d(nearest, 3, axis=1 - axis, mode="constant", cval=np.inf)
        sides = [_before(around, reach, axis), np.flip(_before(np.flip(around, axis), reach, axis), axis)]
        closer = [side[row, column] for side in sides]
        hidden |= np.maximum(*closer) < limit_m
        hidden |= np.minimum(*closer) < _FAR_CLOSER * depth_m
    return hidden


def _cell(uv_px: Floats) -> tuple[Ints, Ints]:
    """Column and row of the grid, which has a rim of one cell."""
    column, row = ((uv_px + 0.5) / _CELL_PX).astype(np.int64).T + 1
    return column, row


def _behind(uv_px: Floats, depth_m: Floats, stands: Bools, glass_px_m: float) -> Bools:
    """(n,) whether a point is ground, and something that stands, very much closer, goes on up to where it appears."""
    if not stands.any():
        return np.zeros(len(uv_px), dtype=np.bool_)
    column, row = _cell(uv_px)
    up = np.minimum(glass_px_m / depth_m / _CELL_PX, row).astype(np.int64)
    nearest = _nearest_upwards(
        row[stands], column[stands], up[stands], depth_m[stands], (row.max() + 1, column.max() + 2)
    )
    nearest = minimum_filter1d(nearest, 3, axis=1, mode="constant", cval=np.inf)
    return np.asarray(~stands & (nearest[row, column] < _FAR_CLOSER * depth_m))


def _nearest_upwards(row: Ints, column: Ints, up: Ints, depth_m: Floats, shape: tuple[int, int]) -> Floats:
    """The least depth in each cell of what reaches from its own row over `up` rows above it, infinite where nothing is.

    Each reach is two runs of a power of two rows, which may overlap; runs are halved until they are single cells.
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


def _before(nearest: Floats, reach: int, axis: int) -> Floats:
    """For each cell the least of the `reach` cells before it along an axis, without itself."""
    least = np.full_like(nearest, np.inf)
    for step in range(1, reach + 1):
        here, there = [slice(None)] * 2, [slice(None)] * 2
        here[axis], there[axis] = slice(step, None), slice(None, -step)
        least[tuple(here)] = np.minimum(least[tuple(here)], nearest[tuple(there)])
    return least


class Choice(NamedTuple):
    """The best view of each point.

    Attributes:
        state: (n,) `SEEN` by at least one camera, else `OCCLUDED` in at least one, else `NO_VIEW`.
        camera: (n,) which camera sees it best, `NO_CAMERA` where none does.
    """

    state: Ints
    camera: Ints


def best(views: Sequence[View], points: int) -> Choice:
    """Of several cameras that see a point, the one in whose picture it lies farthest from the border."""
    if not views:
        return Choice(np.full(points, NO_VIEW, np.int8), np.full(points, NO_CAMERA, np.int8))
    states = np.array([one.state for one in views])
    inset = np.where(states == SEEN, [one.inset_px for one in views], -np.inf)
    seen = (states == SEEN).any(axis=0)
    camera = np.where(seen, inset.argmax(axis=0), NO_CAMERA)
    return Choice(states.min(axis=0).astype(np.int8), camera.astype(np.int8))


def at_time(
    xyz_ego_m: Array,
    velocity_mps: Array | None,
    late_s: float,
    world_from_frame: Array,
    world_from_image: Array,
) -> Floats:
    """(n, 3) the points of a sweep in the ego axes of the moment at which a picture was taken.

    Args:
        xyz_ego_m: (n, 3) points in ego axes at the time of the frame.
        velocity_mps: (n, 3) their motion over the ground in the same axes; None lets them stand.
        late_s: How long after the frame the picture was taken.
        world_from_frame: (4, 4) pose of the frame.
        world_from_image: (4, 4) pose at the time of the picture.
    """
    moved = xyz_ego_m if velocity_mps is None else xyz_ego_m + velocity_mps * late_s
    return np.asarray(apply(inverse(world_from_image) @ world_from_frame, moved))


def sampled(cells: Array, uv_px: Floats, width_px: int, height_px: int) -> Floats:
    """(n, d) features at pixels, bilinear between cells.

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
