"""Fit of the tightest upright box around the points of one object."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array, Boxes, Floats

_MAX_HEADING_POINTS = 400  # a cost limit: a denser sample of the same edges gives no better heading


def to_heading_axes(xy_m: Floats, heading_rad: Floats | float) -> Array:
    """Return (..., 2) coordinates along a heading and to its left.

    Args:
        xy_m: (..., 2) positions.
        heading_rad: One heading, or as many as broadcast with the positions.
    """
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    x, y = xy_m[..., 0], xy_m[..., 1]
    along = x * cos + y * sin
    turned = np.empty((*along.shape, 2), dtype=along.dtype)
    turned[..., 0], turned[..., 1] = along, y * cos - x * sin
    return turned


def rectangle_heading(xy_m: Floats, *, step_rad: float, floor_m: float) -> float:
    """Return the heading in [0, π/2) of the rectangle whose edges are closest to the points.

    The closeness criterion of Zhang, Xu, Dong and Dolan, "Efficient L-shape fitting for vehicle detection
    using laser scanners" (2017), algorithm 3: headings are searched in equal steps, and each point counts
    with the inverse of its distance to the nearer of its two closest edges.

    Args:
        xy_m: (n, 2) points of one object from above.
        step_rad: Step of the search.
        floor_m: Lower bound of the distances, so that no single point decides.
    """
    if len(xy_m) < 2:
        return 0.0
    sample = xy_m[:: -(-len(xy_m) // _MAX_HEADING_POINTS)]
    headings_rad = np.arange(0.0, np.pi / 2, step_rad)
    x, y = np.ascontiguousarray((sample - sample.mean(axis=0)).T)
    cos, sin = np.cos(headings_rad)[:, None], np.sin(headings_rad)[:, None]
    distance_m = np.minimum(_to_edge(x * cos + y * sin), _to_edge(y * cos - x * sin))  # (headings, n)
    return float(headings_rad[np.argmax((1.0 / np.maximum(distance_m, floor_m)).sum(axis=1))])


def _to_edge(along_m: Floats) -> Floats:
    """Return (headings, n) distance of each point from the nearer end of all of them."""
    low, high = along_m.min(axis=1, keepdims=True), along_m.max(axis=1, keepdims=True)
    return np.asarray(np.minimum(along_m - low, high - along_m))


def trimmed_range(values: Floats, trim: float) -> tuple[float, float]:
    """Return the lowest and highest value without a share `trim` of the values at each end."""
    ordered = np.sort(values)
    return _quantile(ordered, trim), _quantile(ordered, 1.0 - trim)


def _quantile(ordered: Floats, share: float) -> float:
    """Return what np.quantile does, which takes far longer for the few points of an object."""
    position = (len(ordered) - 1) * share
    below = int(position)
    past = position - below
    low, high = float(ordered[below]), float(ordered[min(below + 1, len(ordered) - 1)])
    return low + (high - low) * past if past < 0.5 else high - (high - low) * (1 - past)


def median(values: Floats) -> float:
    """Return what np.median does, in a fraction of its time for few values.

    Args:
        values: (n,) values, n > 0.
    """
    ordered, count = np.sort(values), len(values)
    return float((ordered[(count - 1) // 2] + ordered[count // 2]) / 2)


def tight_rectangle(xy_m: Floats, heading_rad: float, *, trim: float) -> tuple[Array, float, float]:
    """Return the (2,) center, length and width of the tightest rectangle of that heading.

    Args:
        xy_m: (n, 2) points of one object from above, n > 0.
        heading_rad: Heading of the length.
        trim: Share of the points left out at each end of length and width (stray points).
    """
    along = to_heading_axes(xy_m, heading_rad)
    (back, front), (right, left) = trimmed_range(along[:, 0], trim), trimmed_range(along[:, 1], trim)
    center = to_heading_axes(np.array([(back + front) / 2, (right + left) / 2]), -heading_rad)
    return center, front - back, left - right


def tight_box(xyz_m: Floats, heading_rad: float, *, trim: float) -> Boxes:
    """Return one box, the tightest upright one of that heading, without a share `trim` of the points at each end.

    Args:
        xyz_m: (n, 3) points of one object, n > 0.
        heading_rad: Heading of the box.
        trim: Share of the points left out at each end of length and width (stray points).
    """
    center, length_m, width_m = tight_rectangle(xyz_m[:, :2], heading_rad, trim=trim)
    low, high = float(xyz_m[:, 2].min()), float(xyz_m[:, 2].max())
    return Boxes(
        np.array([[*center, (low + high) / 2]]),
        np.array([[length_m, width_m, high - low]]),
        np.array([heading_rad]),
    )
