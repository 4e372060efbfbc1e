"""The geometry of boxes on rows of x, y, z, length, width, height, heading: numbers that a person can read."""

from __future__ import annotations

from typing import Any

import numpy as np

from upvl_cli.geometry import boxes as geometry
from upvl_cli.geometry import iou
from upvl_cli.types import Boxes


def of(rows: Any) -> Boxes:
    """Boxes from rows; boxes stay."""
    return rows if isinstance(rows, Boxes) else Boxes.from_rows(rows)


def iou_3d(a: Any, b: Any) -> np.ndarray:
    return iou.iou_3d(of(a), of(b))


def iou_3d_pairs(a: Any, b: Any) -> np.ndarray:
    return iou.iou_3d_pairs(of(a), of(b))


def iou_bev(a: Any, b: Any) -> np.ndarray:
    return iou.iou_bev(of(a), of(b))


def iou_bev_pairs(a: Any, b: Any) -> np.ndarray:
    return iou.iou_bev_pairs(of(a), of(b))


def corners(boxes: Any) -> np.ndarray:
    return geometry.corners(of(boxes))


def corners_bev(boxes: Any) -> np.ndarray:
    return geometry.corners_bev(of(boxes))


def points_inside(xyz: Any, boxes: Any, *, margin_m: float) -> np.ndarray:
    return geometry.points_inside(xyz, of(boxes), margin_m=margin_m)


def pairs_inside(xyz: Any, boxes: Any, *, margin_m: float) -> tuple[np.ndarray, np.ndarray]:
    return geometry.pairs_inside(xyz, of(boxes), margin_m=margin_m)


def transform(boxes: Any, dst_from_src: np.ndarray) -> np.ndarray:
    return geometry.transform(of(boxes), dst_from_src).to_rows()
