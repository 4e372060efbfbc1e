"""Exact overlap of upright rotated boxes, for pairs and for matrices.

The overlap of two rectangles is found without vertices, sorting or cases. In the axes of the first one,
[-a, a] x [-b, b], each edge of the second bounds the area from above or from below; what an edge adds is
the integral over x in [-a, a] of its height, held to [-b, b]. Each integral is closed-form and continuous,
so shared edges and parallel boxes are as exact as any other. The definition of the 3D value is the
Waymo Open Dataset's, metrics/iou.cc: sizes of 1e6 m and more, 3D sizes up to 1 cm and unions up to 1e-6
give 0.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.boxes import check_finite
from upvl_cli.types import Array, Boxes, Ints

_PAIRS_PER_BLOCK = 4096  # (4, 4096) float64 is 128 KiB: the kernel's temporaries stay in the L2 cache
_REJECTIONS_PER_BLOCK = 32768  # the same for the rejection, which holds a few (rows, columns) temporaries
_SIZE_TOO_LARGE_M = 1e6
_SIZE_TOO_SMALL_3D_M = 1e-2
_UNION_TOO_SMALL = 1e-6
_AREA_TOO_SMALL_M2 = 5e-11
_STEEPEST = 1e-30  # a cosine below this makes an edge vertical; its integral is 0 whatever its slope


def iou_bev_pairs(a: Boxes, b: Boxes) -> Array:
    """Return (n,) bird's-eye IoU of each row of `a` with the same row of `b`.

    Args:
        a: n boxes.
        b: n boxes in the same axes.

    Raises:
        BadInput: A box is not finite, or there are not as many of them.
    """
    return _iou_of_pairs(check_finite(a), check_finite(b), 2)


def iou_3d_pairs(a: Boxes, b: Boxes) -> Array:
    """Return (n,) 3D IoU of each row of `a` with the same row of `b`.

    Args:
        a: n boxes.
        b: n boxes in the same axes.

    Raises:
        BadInput: A box is not finite, or there are not as many of them.
    """
    return _iou_of_pairs(check_finite(a), check_finite(b), 3)


def iou_bev(a: Boxes, b: Boxes) -> Array:
    """Return (n, m) bird's-eye IoU of every pair.

    Args:
        a: n boxes.
        b: m boxes in the same axes.

    Raises:
        BadInput: A box is not finite.
    """
    return _iou_of_all(check_finite(a), check_finite(b), 2)


def iou_3d(a: Boxes, b: Boxes) -> Array:
    """Return (n, m) 3D IoU of every pair.

    Args:
        a: n boxes.
        b: m boxes in the same axes.

    Raises:
        BadInput: A box is not finite.
    """
    return _iou_of_all(check_finite(a), check_finite(b), 3)


def _columns(boxes: Boxes, dimensions: int) -> Array:
    """Return (9, n): x, y, z, half l, half w, half h, cos, sin, radius (NaN where every IoU is 0)."""
    x, y, z = np.ascontiguousarray(boxes.center_m.T)
    length, width, height = np.ascontiguousarray(boxes.size_lwh_m.T)
    heading = np.ascontiguousarray(boxes.heading_rad)
    smallest = _SIZE_TOO_SMALL_3D_M if dimensions == 3 else 0.0
    sizes = np.stack([length, width, height][:dimensions])
    usable = ((sizes > smallest) & (sizes < _SIZE_TOO_LARGE_M)).all(axis=0)
    radius = np.where(usable, np.sqrt(length * length + width * width) / 2, np.nan)
    half = length / 2, width / 2, height / 2
    return np.stack([x, y, z, *half, np.cos(heading), np.sin(heading), radius])


@np.errstate(over="ignore")  # an infinite distance is far, an infinite size not usable
def _iou_of_pairs(a: Boxes, b: Boxes, dimensions: int) -> Array:
    if len(a) != len(b):
        raise BadInput(f"pairs of boxes: {len(a)} boxes against {len(b)}, expected as many")
    iou = np.zeros(len(a))
    for start in range(0, len(a), _PAIRS_PER_BLOCK):
        block = slice(start, start + _PAIRS_PER_BLOCK)
        first, second = _columns(a[block], dimensions), _columns(b[block], dimensions)
        near = np.flatnonzero(_near(first, second))
        iou[block][near] = _iou(first, second, near, near, dimensions)
    return iou


@np.errstate(over="ignore")
def _iou_of_all(a: Boxes, b: Boxes, dimensions: int) -> Array:
    """Reject far pairs block by block, so that only near ones pay and no temporary is a whole matrix."""
    iou = np.zeros((len(a), len(b)))
    columns_a, columns_b = _columns(a, dimensions), _columns(b, dimensions)
    width = max(min(len(b), _REJECTIONS_PER_BLOCK), 1)
    height = _REJECTIONS_PER_BLOCK // width
    for top in range(0, len(a), height):
        for left in range(0, len(b), width):
            first, second = columns_a[:, top : top + height], columns_b[:, left : left + width]
            row, column = np.nonzero(_near(first[:, :, None], second[:, None, :]))
            for start in range(0, len(row), _PAIRS_PER_BLOCK):
                i, j = row[start : start + _PAIRS_PER_BLOCK], column[start : start + _PAIRS_PER_BLOCK]
                iou[top + i, left + j] = _iou(first, second, i, j, dimensions)
    return iou


def _near(a: Array, b: Array) -> Array:
    """Return whether the circles around two rectangles meet; a NaN radius meets nothing."""
    dx, dy, reach = b[0] - a[0], b[1] - a[1], a[8] + b[8]
    dx *= dx
    dy *= dy
    dx += dy
    reach *= reach
    return np.asarray(dx <= reach)


def _iou(a: Array, b: Array, row: Ints, column: Ints, dimensions: int) -> Array:
    """Return (k,) IoU of column row[k] of `a` with column column[k] of `b`."""
    a, b = a.take(row, axis=1), b.take(column, axis=1)
    shared, size_a, size_b = _shared_m2(a, b), 4 * a[3] * a[4], 4 * b[3] * b[4]
    if dimensions == 3:
        overlap_m = np.minimum(a[2] + a[5], b[2] + b[5]) - np.maximum(a[2] - a[5], b[2] - b[5])
        shared *= np.maximum(overlap_m, 0)
        size_a *= 2 * a[5]
        size_b *= 2 * b[5]
    union = size_a + size_b - shared
    iou = np.where(union > _UNION_TOO_SMALL, shared / np.maximum(union, _UNION_TOO_SMALL), 0)
    return np.clip(iou, 0, 1)


def _shared_m2(a: Array, b: Array) -> Array:
    """Return (n,) area that the rectangles of each pair share, in square metres."""
    cos, sin = a[6] * b[6] + a[7] * b[7], a[6] * b[7] - a[7] * b[6]  # of b's heading in a's axes
    dx, dy = b[0] - a[0], b[1] - a[1]  # the local origin: no digits lost far from the world's
    cx, cy = dx * a[6] + dy * a[7], dy * a[6] - dx * a[7]
    lx, ly, wx, wy = b[3] * cos, b[3] * sin, -b[4] * sin, b[4] * cos
    x = np.stack([cx + lx + wx, cx - lx + wx, cx - lx - wx, cx + lx - wx])  # (4, n), counter-clockwise
    y = np.stack([cy + ly + wy, cy - ly + wy, cy - ly - wy, cy + ly - wy])
    lengthwise, crosswise = sin / _not_zero(cos), -cos / _not_zero(sin)
    slope = np.stack([lengthwise, crosswise, lengthwise, crosswise])
    following = [1, 2, 3, 0]

    clipped_x = np.clip(x, -a[3], a[3])
    cut = clipped_x - x
    mean_y = _mean_clipped(y + cut * slope, y[following] + cut[following] * slope, a[4])
    area = ((clipped_x - clipped_x[following]) * mean_y).sum(axis=0)
    return np.where(area > _AREA_TOO_SMALL_M2, area, 0)


def _not_zero(values: Array) -> Array:
    return np.where(np.abs(values) < _STEEPEST, _STEEPEST, values)


def _mean_clipped(start: Array, end: Array, bound: Array) -> Array:
    """Return the mean of clip(y, -bound, bound) for y going evenly from `start` to `end`.

    The middle of the clipped ends is right for the part of the way within the bounds; each part beyond one
    pulls the mean towards that bound by its share of the way.
    """
    clipped_start, clipped_end = np.clip(start, -bound, bound), np.clip(end, -bound, bound)
    middle = (clipped_start + clipped_end) / 2
    beyond_start, beyond_end = start - clipped_start, end - clipped_end
    pull = bound * (beyond_start + beyond_end) - middle * (np.abs(beyond_start) + np.abs(beyond_end))
    return np.asarray(middle + pull / (np.abs(end - start) + 1e-300))  # no way, no pull
