"""Upright boxes: their corners, the points inside them, and their change of axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import apply, wrap_angle, yaw_of
from upvl_cli.types import Array, Bools, Boxes, Ints

_FEW_BOXES = 4  # up to so many, a pass over all points for each box is quicker than sorting the points
_ROUNDING_M = 1e-6  # spare room of the first, coarse test: a thousand times the rounding of world coordinates
# Front left, rear left, rear right, front right: counter-clockwise, in half lengths and half widths.
_CORNER_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def geometry_of(boxes: Boxes) -> Boxes:
    """Return plain boxes, without what a subclass adds."""
    return Boxes(boxes.center_m, boxes.size_lwh_m, boxes.heading_rad)


def check_finite(boxes: Boxes) -> Boxes:
    """Return the boxes, plain, after a check that every number of them is finite.

    Args:
        boxes: n boxes.

    Raises:
        BadInput: A number is NaN or infinite; the message names the first such box.
    """
    boxes = geometry_of(boxes)
    finite = np.isfinite(boxes.heading_rad)
    finite &= np.isfinite(boxes.center_m).all(axis=1) & np.isfinite(boxes.size_lwh_m).all(axis=1)
    if not finite.all():
        index = int(np.argmin(finite))
        row = boxes[index : index + 1].to_rows()[0].tolist()
        raise BadInput(f"box {index} is not finite: {row}; drop it or mend its source")
    return boxes


def corners_bev(boxes: Boxes) -> Array:
    """Return (n, 4, 2) corners seen from above: front left, rear left, rear right, front right.

    Args:
        boxes: n boxes.

    Raises:
        BadInput: A box is not finite.
    """
    boxes = check_finite(boxes)
    along, across = np.moveaxis(_CORNER_SIGNS * boxes.size_lwh_m[:, None, :2] / 2, -1, 0)
    cos, sin = np.cos(boxes.heading_rad)[:, None], np.sin(boxes.heading_rad)[:, None]
    turned = np.stack([along * cos - across * sin, along * sin + across * cos], axis=-1)
    return np.asarray(boxes.center_m[:, None, :2] + turned)


def corners(boxes: Boxes) -> Array:
    """Return (n, 8, 3) corners: the four of `corners_bev` on the floor, then the same on the roof.

    Args:
        boxes: n boxes.

    Raises:
        BadInput: A box is not finite.
    """
    boxes = check_finite(boxes)
    rise = boxes.size_lwh_m[:, 2:] * np.repeat([-0.5, 0.5], 4)
    height = boxes.center_m[:, 2:] + rise
    return np.concatenate([np.tile(corners_bev(boxes), (1, 2, 1)), height[..., None]], axis=-1)


def pairs_inside(xyz: Array, boxes: Boxes, *, margin_m: float) -> tuple[Ints, Ints]:
    """Return which points lie in which boxes, as (box, point) numbers in ascending order.

    Memory grows with the hits only: each box looks at its own strip of x, for which points are sorted once where
    boxes are many.

    Args:
        xyz: (m, 3) points in the axes of the boxes; a point that is not finite lies nowhere.
        boxes: n boxes; their faces belong to them.
        margin_m: The boxes grow by this on every side; negative shrinks them.

    Raises:
        BadInput: A box is not finite.
    """
    boxes, xyz = check_finite(boxes), np.asarray(xyz, dtype=np.float64).reshape(-1, 3)
    center_m = boxes.center_m
    cos, sin = np.cos(boxes.heading_rad), np.sin(boxes.heading_rad)
    half = boxes.size_lwh_m / 2 + margin_m
    reach = np.abs(cos) * half[:, 0] + np.abs(sin) * half[:, 1] + _ROUNDING_M
    hits = []
    for i, strip in enumerate(_strips(xyz[:, 0], center_m[:, 0], reach)):
        dx, dy, dz = (xyz[strip] - center_m[i]).T
        inside = np.abs(dx * cos[i] + dy * sin[i]) <= half[i, 0]
        inside &= np.abs(dy * cos[i] - dx * sin[i]) <= half[i, 1]
        inside &= np.abs(dz) <= half[i, 2]
        hits.append(np.sort(strip[inside]))
    if not hits:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return np.repeat(np.arange(len(boxes)), [len(hit) for hit in hits]), np.concatenate(hits)


def _strips(x: Array, middle: Array, reach: Array) -> Iterator[Ints]:
    """Yield for each box the points whose x is no farther than `reach` from its `middle`."""
    if len(middle) <= _FEW_BOXES:
        for center, far in zip(middle, reach, strict=True):
            yield np.flatnonzero(np.abs(x - center) <= far)
        return
    order = np.argsort(x, kind="stable")
    first = np.searchsorted(x[order], middle - reach, side="left")
    last = np.searchsorted(x[order], middle + reach, side="right")
    for start, end in zip(first, last, strict=True):
        yield order[start:end]


def points_inside(xyz: Array, boxes: Boxes, *, margin_m: float) -> Bools:
    """Return (n, m), whether box n holds point m; see `pairs_inside` for many boxes.

    Args:
        xyz: (m, 3) points in the axes of the boxes.
        boxes: n boxes; their faces belong to them.
        margin_m: The boxes grow by this on every side; negative shrinks them.

    Raises:
        BadInput: A box is not finite.
    """
    box, point = pairs_inside(xyz, boxes, margin_m=margin_m)
    inside = np.zeros((len(boxes), len(xyz)), dtype=np.bool_)
    inside[box, point] = True
    return inside


def transform(boxes: Boxes, dst_from_src: Array) -> Boxes:
    """Return the boxes, plain, in the axes of dst; headings turn by the yaw, so upright stays upright.

    Args:
        boxes: n boxes in the axes of src; what a subclass adds, such as a velocity, is left behind.
        dst_from_src: (4, 4) rigid transform.

    Raises:
        BadInput: A box is not finite.
    """
    source = check_finite(boxes)
    return Boxes(
        center_m=apply(dst_from_src, source.center_m),
        size_lwh_m=source.size_lwh_m,
        heading_rad=wrap_angle(source.heading_rad + yaw_of(dst_from_src)),
    )
