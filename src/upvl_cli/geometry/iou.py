"""Exact overlap of upright rotated boxes, for pairs and for matrices.

The overlap of two rectangles is found without vertices, sorting or cases. In the axes of the first one,
[-a, a] x [-b, b], each edge of the second bounds the area from above or from below; what an edge adds is
the integral over x in [-a, a] of its height, held to [-b, b]. Each integral is closed-form and continuous,
so shared edges and parallel boxes are as exact as any other. The definition of the 3D value is the
Waymo Open Dataset's, metrics/iou.cc: sizes of 1e6 m and more, 3D sizes up to 1 cm and unions up to 1e-6
give 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.boxes import checked
from upvl_cli.types import Array, Ints

_PAIRS_A_BLOCK = 4096  # (4, 4096) float64 is 128 KiB: the kernel's temporaries stay in the L2 cache
_REJECTS_A_BLOCK = 32768  # the same for the rejection, which holds a few (rows, columns) temporaries
_SIZE_TOO_LARGE_M = 1e6
_SIZE_TOO_SMALL_3D_M = 1e-2
_UNION_TOO_SMALL = 1e-6
_AREA_TOO_SMALL_M2 = 5e-11
_STEEPEST = 1e-30  # a cosine below this makes an edge vertical; its integral is 0 whatever its slope


def iou_bev_pairs(a: Array, b: Array) -> Array:
    """Return (n,) bird's-eye IoU of each row of `a` with the same row of `b`.

    Args:
        a: (n, 7) boxes x, y, z, l, w, h, heading.
        b: (n, 7) boxes.

    Raises:
        BadInput: A box is not finite, or there are not as many of them.
    """
    return _of_pairs(_columns(a, 0.0, 2), _columns(b, 0.0, 2), _bev)


def iou_3d_pairs(a: Array, b: Array) -> Array:
    """Return (n,) 3D IoU of each row of `a` with the same row of `b`.

    Args:
        a: (n, 7) boxes x, y, z, l, w, h, heading.
        b: (n, 7) boxes.

    Raises:
        BadInput: A box is not finite, or there are not as many of them.
    """
    return _of_pairs(_columns(a, _SIZE_TOO_SMALL_3D_M, 3), _columns(b, _SIZE_TOO_SMALL_3D_M, 3), _volume)


def iou_bev(a: Array, b: Array) -> Array:
    """Return (n, m) bird's-eye IoU of every pair.

    Args:
        a: (n, 7) boxes x, y, z, l, w, h, heading.
        b: (m, 7) boxes.

    Raises:
        BadInput: A box is not finite.
    """
    return _of_all(_columns(a, 0.0, 2), _columns(b, 0.0, 2), _bev)


def iou_3d(a: Array, b: Array) -> Array:
    """Return (n, m) 3D IoU of every pair.

    Args:
        a: (n, 7) boxes x, y, z, l, w, h, heading.
        b: (m, 7) boxes.

    Raises:
        BadInput: A box is not finite.
    """
    return _of_all(_columns(a, _SIZE_TOO_SMALL_3D_M, 3), _columns(b, _SIZE_TOO_SMALL_3D_M, 3), _volume)


def _columns(boxes: Array, smallest_m: float, dimensions: int) -> Array:
    """Return (9, n): x, y, z, half l, half w, half h, cos, sin, radius (NaN where every IoU is 0)."""
    boxes = checked(boxes)
    sizes = boxes[:, 3 : 3 + dimensions]
    usable = ((sizes > smallest_m) & (sizes < _SIZE_TOO_LARGE_M)).all(axis=1)
    half = boxes[:, 3:6].T / 2
    radius = np.full(len(boxes), np.nan)
    radius[usable] = np.hypot(half[0, usable], half[1, usable])
    return np.vstack([boxes[:, :3].T, half, np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), radius])


def _of_pairs(a: Array, b: Array, measure: Callable[[Array, Array], Array]) -> Array:
    if a.shape != b.shape:
        raise BadInput(f"pairs of boxes: {a.shape[1]} boxes against {b.shape[1]}, expected as many")
    iou = np.zeros(a.shape[1])
    for start in range(0, a.shape[1], _PAIRS_A_BLOCK):
        block = slice(start, start + _PAIRS_A_BLOCK)
        near = np.flatnonzero(_near(a[:, block], b[:, block]))
        iou[block][near] = measure(a[:, block][:, near], b[:, block][:, near])
    return iou


def _of_all(a: Array, b: Array, measure: Callable[[Array, Array], Array]) -> Array:
    """Reject far pairs block by block, so that only near ones pay and no temporary is a whole matrix."""
    iou = np.zeros((a.shape[1], b.shape[1]))
    width = max(min(b.shape[1], _REJECTS_A_BLOCK), 1)
    height = _REJECTS_A_BLOCK // width
    for top in range(0, a.shape[1], height):
        for left in range(0, b.shape[1], width):
            rows, columns = a[:, top : top + height], b[:, left : left + width]
            near = _near(rows[:, :, None], columns[:, None, :])
            row, column = np.nonzero(near)
            iou[top + row, left + column] = _in_blocks(rows, columns, row, column, measure)
    return iou


def _in_blocks(
    a: Array, b: Array, row: Ints, column: Ints, measure: Callable[[Array, Array], Array]
) -> Array:
    starts = range(0, len(row), _PAIRS_A_BLOCK)
    parts = [slice(start, start + _PAIRS_A_BLOCK) for start in starts]
    return np.concatenate([np.zeros(0), *(measure(a[:, row[part]], b[:, column[part]]) for part in parts)])


def _near(a: Array, b: Array) -> Array:
    """Whether the circles around two rectangles meet; a NaN radius meets nothing."""
    with np.errstate(over="ignore"):  # an infinite distance is far
        dx, dy, reach = b[0] - a[0], b[1] - a[1], a[8] + b[8]
        dx *= dx
        dy *= dy
        dx += dy
        reach *= reach
        return np.asarray(dx <= reach)


def _bev(a: Array, b: Array) -> Array:
    overlap = _overlap_m2(a, b)
    return _ratio(overlap, 4 * (a[3] * a[4] + b[3] * b[4]) - overlap)


def _volume(a: Array, b: Array) -> Array:
    dz = np.minimum(a[2] + a[5], b[2] + b[5]) - np.maximum(a[2] - a[5], b[2] - b[5])
    overlap = _overlap_m2(a, b) * np.maximum(dz, 0)
    return _ratio(overlap, 8 * (a[3] * a[4] * a[5] + b[3] * b[4] * b[5]) - overlap)


def _ratio(overlap: Array, union: Array) -> Array:
    iou = np.where(union > _UNION_TOO_SMALL, overlap / np.maximum(union, _UNION_TOO_SMALL), 0)
    return np.asarray(np.clip(iou, 0, 1))


def _overlap_m2(a: Array, b: Array) -> Array:
    """Return (n,) area that the rectangles of each pair share, in square metres."""
    cos, sin = a[6] * b[6] + a[7] * b[7], a[6] * b[7] - a[7] * b[6]  # of b's heading in a's axes
    dx, dy = b[0] - a[0], b[1] - a[1]  # the local origin: no digits lost far from the world's
    cx, cy = dx * a[6] + dy * a[7], dy * a[6] - dx * a[7]
    lx, ly, wx, wy = b[3] * cos, b[3] * sin, -b[4] * sin, b[4] * cos
    x = np.stack([cx + lx + wx, cx - lx + wx, cx - lx - wx, cx + lx - wx])  # (4, n), counter-clockwise
    y = np.stack([cy + ly + wy, cy - ly + wy, cy - ly - wy, cy + ly - wy])
    along, across = sin / _not_zero(cos), -cos / _not_zero(sin)
    slope = np.stack([along, across, along, across])
    half_l, half_w = a[3], a[4]

    held_x = np.clip(x, -half_l, half_l)
    start = y + (held_x - x) * slope
    shift = held_x - x
    end = y[[1, 2, 3, 0]] + shift[[1, 2, 3, 0]] * slope
    width = held_x - held_x[[1, 2, 3, 0]]
    area = (width * _mean_held(start, end, half_w)).sum(axis=0)
    return np.where(area > _AREA_TOO_SMALL_M2, area, 0)


def _not_zero(values: Array) -> Array:
    return np.where(np.abs(values) < _STEEPEST, _STEEPEST, values)


def _mean_held(start: Array, end: Array, bound: Array) -> Array:
    """Return the mean of clip(y, -bound, bound) for y going evenly from `start` to `end`.

    The middle of the clipped ends is right for the part within; each part beyond a bound pulls the mean
    towards that bound by its share of the way.
    """
    held_start, held_end = np.clip(start, -bound, bound), np.clip(end, -bound, bound)
    middle = (held_start + held_end) / 2
    above = np.abs(np.maximum(end, bound) - np.maximum(start, bound))
    below = np.abs(np.minimum(end, -bound) - np.minimum(start, -bound))
    pull = above * (bound - middle) - below * (bound + middle)
    return np.asarray(middle + pull / (np.abs(end - start) + 1e-300))
