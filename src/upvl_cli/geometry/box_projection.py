"""3D boxes as a picture shows them: the upright rectangle around the projection of each."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.camera import project
from upvl_cli.types import Array, Camera, Floats

# Corners 0-3 are the bottom and 4-7 the top, both counter-clockwise from the front left (`geometry.boxes.corners`).
_EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
_SAMPLES = 9  # places on an edge: a lens bends edges, and a part of one can lie behind the camera


def projected_boxes(camera: Camera, corners_m: Array) -> tuple[Floats, Floats]:
    """Return where boxes appear: (n, 4) edges in pixels, clipped to the picture, and (n,) the share inside of it.

    The share is that of the unclipped rectangle's area; it is 0, and the edges are NaN, where nothing is in view.

    Args:
        camera: Where it is and how it sees.
        corners_m: (n, 8, 3) corners in ego axes at the time of the picture, in the order of `boxes.corners`.
    """
    part = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    start, end = (np.asarray(corners_m)[:, _EDGES[:, side], None] for side in (0, 1))
    places_m = start * (1 - part) + end * part  # (n, 12, samples, 3)
    uv_px = project(camera, places_m.reshape(-1, 3))[0].reshape(len(places_m), len(_EDGES) * _SAMPLES, 2)
    is_seen = ~np.isnan(uv_px).any(axis=2, keepdims=True)
    low = np.where(is_seen, uv_px, np.inf).min(axis=1, initial=np.inf)
    high = np.where(is_seen, uv_px, -np.inf).max(axis=1, initial=-np.inf)
    border = np.array([camera.width_px, camera.height_px]) - 0.5
    edges_px = np.hstack([np.clip(low, -0.5, border), np.clip(high, -0.5, border)])
    inner = edges_px[:, 2:] - edges_px[:, :2]
    in_view = (low < high).all(axis=1) & (inner > 0).all(axis=1)
    edges_px[~in_view] = np.nan
    area = np.where(in_view[:, None], high - low, 1.0).prod(axis=1)
    return edges_px, np.where(in_view, inner.prod(axis=1) / area, 0.0)


def iou_of_rectangles(first_px: Floats, second_px: Floats) -> Floats:
    """Return (n, m) IoU of upright rectangles; 0 where one has edges that are NaN.

    Args:
        first_px: (n, 4) left, top, right and bottom edge.
        second_px: (m, 4) the others.
    """
    first, second = first_px[:, None], second_px[None]
    inner = np.minimum(first[..., 2:], second[..., 2:]) - np.maximum(first[..., :2], second[..., :2])
    shared = np.maximum(inner, 0).prod(axis=2)
    areas = [(each[..., 2:] - each[..., :2]).prod(axis=2) for each in (first, second)]
    union = areas[0] + areas[1] - shared
    is_known = union > 0  # false for NaN as well
    return np.asarray(np.where(is_known, shared / np.where(is_known, union, 1.0), 0.0))
