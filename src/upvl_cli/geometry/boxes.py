"""Upright boxes as (n, 7) rows of x, y, z of the centre, length, width, height (m), heading (rad)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, wrap_angle, yaw_of
from upvl_cli.types import Array, Bools, Boxes, Ints

B = TypeVar("B", Boxes, Array)
_FEW = 4  # boxes for which sorting all points does not pay
# Front left, rear left, rear right, front right: counter-clockwise, in half lengths and half widths.
_CORNER_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def as_rows(boxes: Boxes | Array) -> Array:
    """TEMPORARY: (n, 7) rows of boxes, until every room uses the named parts."""
    return boxes.to_rows() if isinstance(boxes, Boxes) else boxes


def checked(boxes: Boxes | Array) -> Array:
    """Return the boxes as (n, 7) float64.

    Args:
        boxes: (n, 7) boxes, or nothing at all.

    Raises:
        BadInput: The shape is another one, or a number is NaN or infinite.
    """
    boxes = np.asarray(as_rows(boxes), dtype=np.float64)
    if boxes.size == 0:
        return np.zeros((0, 7))
    if boxes.ndim != 2 or boxes.shape[1] != 7:
        raise BadInput(f"boxes have shape {boxes.shape}, expected (n, 7): x, y, z, l, w, h, heading")
    if not np.isfinite(boxes).all():
        row = int(np.flatnonzero(~np.isfinite(boxes).all(axis=1))[0])
        raise BadInput(f"box {row} is not finite: {boxes[row].tolist()}; drop it or mend its source")
    return boxes


def corners_bev(boxes: Boxes | Array) -> Array:
    """Return (n, 4, 2) corners seen from above: front left, rear left, rear right, front right.

    Args:
        boxes: (n, 7) boxes.
    """
    boxes = checked(boxes)
    along, across = np.moveaxis(_CORNER_SIGNS * boxes[:, None, 3:5] / 2, -1, 0)
    cos, sin = np.cos(boxes[:, 6:]), np.sin(boxes[:, 6:])
    turned = np.stack([along * cos - across * sin, along * sin + across * cos], axis=-1)
    return np.asarray(boxes[:, None, :2] + turned)


def corners(boxes: Boxes | Array) -> Array:
    """Return (n, 8, 3) corners: the four of `corners_bev` on the floor, then the same on the roof.

    Args:
        boxes: (n, 7) boxes.
    """
    boxes = checked(boxes)
    rise = boxes[:, 5:6] * np.repeat([-0.5, 0.5], 4)
    height = boxes[:, 2:3] + rise
    return np.concatenate([np.tile(corners_bev(boxes), (1, 2, 1)), height[..., None]], axis=-1)


def pairs_inside(xyz: Array, boxes: Boxes | Array, *, margin_m: float) -> tuple[Ints, Ints]:
    """Return which points lie in which boxes, as (box, point) numbers in ascending order.

    Memory grows with the hits only: each box looks at its own strip of x, for which points are sorted once where
    boxes are many.

    Args:
        xyz: (m, 3) points in the axes of the boxes; a point that is not finite lies nowhere.
        boxes: (n, 7) boxes; their faces belong to them.
        margin_m: The boxes grow by this on every side; negative shrinks them.
    """
    boxes, xyz = checked(boxes), np.asarray(xyz, dtype=np.float64).reshape(-1, 3)
    cos, sin = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    half = boxes[:, 3:6] / 2 + margin_m
    reach = np.abs(cos) * half[:, 0] + np.abs(sin) * half[:, 1] + 1e-6  # spare room for rounding
    hits = []
    for i, strip in enumerate(_strips(xyz[:, 0], boxes[:, 0], reach)):
        dx, dy, dz = (xyz[strip] - boxes[i, :3]).T
        inside = np.abs(dx * cos[i] + dy * sin[i]) <= half[i, 0]
        inside &= np.abs(dy * cos[i] - dx * sin[i]) <= half[i, 1]
        inside &= np.abs(dz) <= half[i, 2]
        hits.append(np.sort(strip[inside]))
    if not hits:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return np.repeat(np.arange(len(boxes)), [len(hit) for hit in hits]), np.concatenate(hits)


def _strips(x: Array, middle: Array, reach: Array) -> Iterator[Ints]:
    """The points whose x is no farther than its reach from the middle of each box."""
    if len(middle) <= _FEW:
        for centre, far in zip(middle, reach, strict=True):
            yield np.flatnonzero(np.abs(x - centre) <= far)
        return
    order = np.argsort(x, kind="stable")
    first = np.searchsorted(x[order], middle - reach, side="left")
    last = np.searchsorted(x[order], middle + reach, side="right")
    for start, end in zip(first, last, strict=True):
        yield order[start:end]


def points_inside(xyz: Array, boxes: Boxes | Array, *, margin_m: float) -> Bools:
    """Return (n, m), whether box n holds point m; see `pairs_inside` for many boxes.

    Args:
        xyz: (m, 3) points in the axes of the boxes.
        boxes: (n, 7) boxes; their faces belong to them.
        margin_m: The boxes grow by this on every side; negative shrinks them.
    """
    box, point = pairs_inside(xyz, boxes, margin_m=margin_m)
    inside = np.zeros((len(boxes), len(xyz)), dtype=np.bool_)
    inside[box, point] = True
    return inside


def transform(boxes: B, dst_from_src: Array) -> B:
    """Return the boxes in the axes of dst; headings turn by the yaw, so upright stays upright.

    Args:
        boxes: (n, 7) boxes in the axes of src.
        dst_from_src: (4, 4) rigid transform.
    """
    moved = checked(boxes).copy()
    moved[:, :3] = apply(dst_from_src, moved[:, :3])
    moved[:, 6] = wrap_angle(moved[:, 6] + yaw_of(dst_from_src))
    if isinstance(boxes, Boxes):
        return Boxes.from_rows(moved)
    return moved
