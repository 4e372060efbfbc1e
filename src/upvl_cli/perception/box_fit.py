"""The tightest upright box around the points of one object."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array, Floats

MOST_POINTS = 400  # that a heading is found from: more of the same edges tell no more


def along(xy_m: Floats, heading_rad: Floats | float) -> Array:
    """Coordinates along and across a heading.

    Args:
        xy_m: (..., 2) positions.
        heading_rad: One heading, or as many as broadcast with the positions.
    """
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    x, y = xy_m[..., 0], xy_m[..., 1]
    return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)


def rectangle_heading(xy_m: Floats, *, step_rad: float, floor_m: float) -> float:
    """Heading in [0, π/2) of the rectangle whose edges the points hug best.

    The closeness rule of Zhang, Xu, Dong and Dolan, "Efficient L-shape fitting for vehicle detection
    using laser scanners" (2017), algorithm 3: every heading of a fan is tried, and each point counts
    with the inverse of its distance to the nearer of its two closest edges.

    Args:
        xy_m: (n, 2) points of one object from above.
        step_rad: Step of the fan.
        floor_m: Distances below this count as this, so that no single point decides.
    """
    if len(xy_m) < 2:
        return 0.0
    thin = xy_m[:: -(-len(xy_m) // MOST_POINTS)]
    fan_rad = np.arange(0.0, np.pi / 2, step_rad)
    x, y = np.ascontiguousarray((thin - thin.mean(axis=0)).T)
    cos, sin = np.cos(fan_rad)[:, None], np.sin(fan_rad)[:, None]
    gap = np.minimum(_to_edge(x * cos + y * sin), _to_edge(y * cos - x * sin))  # (headings, n)
    return float(fan_rad[np.argmax((1.0 / np.maximum(gap, floor_m)).sum(axis=1))])


def _to_edge(along_m: Floats) -> Floats:
    """(headings, n) distance of each point from the nearer end of all of them."""
    low, high = along_m.min(axis=1, keepdims=True), along_m.max(axis=1, keepdims=True)
    return np.asarray(np.minimum(along_m - low, high - along_m))


def span(values: Floats, trim: float) -> tuple[float, float]:
    """Lowest and highest value without a share `trim` of the values at each end."""
    low, high = np.quantile(values, (trim, 1.0 - trim))
    return float(low), float(high)


def tight_box(xyz_m: Floats, heading_rad: float, *, trim: float) -> Array:
    """(7,) tightest upright box of that heading around the points, but for a share `trim` at each end.

    Args:
        xyz_m: (n, 3) points of one object, n > 0.
        heading_rad: Heading of the box.
        trim: Share of the points left out at each end of length and width (stray points).
    """
    turned = along(xyz_m[:, :2], heading_rad)
    (back, front), (right, left) = span(turned[:, 0], trim), span(turned[:, 1], trim)
    low, high = float(xyz_m[:, 2].min()), float(xyz_m[:, 2].max())
    centre = along(np.array([(back + front) / 2, (right + left) / 2]), -heading_rad)
    return np.array(
        [*centre, (low + high) / 2, front - back, left - right, high - low, heading_rad], dtype=np.float64
    )
