"""What the 3D view draws: the points of a sweep as numbers of two bytes, and the boxes of a frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from upvl_cli.types import Array
from upvl_cli.web.catalog import Catalog

MOST_POINTS = 20_000
REACH_M = 75.0  # to each side of the car: what is farther has few points
CENTIMETRES = 100.0


def packed_points(xyz_ego_m: Array) -> bytes:
    """Return points as little-endian int16 centimetres, three a point, thinned evenly to `MOST_POINTS`.

    Args:
        xyz_ego_m: (n, 3) points of a sweep; those that are far away or not finite are left out.
    """
    near = np.flatnonzero((np.abs(xyz_ego_m) <= REACH_M).all(axis=1))
    if len(near) > MOST_POINTS:
        near = near[np.linspace(0, len(near) - 1, MOST_POINTS).astype(np.int64)]
    return np.rint(xyz_ego_m[near] * CENTIMETRES).astype("<i2").tobytes()


def boxes_of_frame(catalog: Catalog, segment: str, frame: int) -> dict[str, Any]:
    """Return the boxes of a frame as JSON has them: centre, size, heading, speed, track, name."""
    objects = catalog.objects(segment)
    low, high = (int(place) for place in np.searchsorted(objects.frame, [frame, frame + 1]))
    here, names = objects[low:high], catalog.names(segment)
    speed = here.speed_mps
    boxes = [
        {
            "center": _rounded(here.center_m[row]),
            "size": _rounded(here.size_lwh_m[row]),
            "heading": round(float(here.heading_rad[row]), 4),
            "speed": round(float(speed[row]), 2),
            "score": round(float(here.confidence[row]), 3),
            "track": int(here.track_id[row]),
            "name": str(names.word[low + row] or names.class_name[low + row]),
        }
        for row in range(len(here))
    ]
    return {"frame": frame, "time_s": round(float(here.time_s[0]), 3) if len(here) else None, "boxes": boxes}


def _rounded(values: Array) -> list[float]:
    return [round(float(value), 3) for value in values]
