"""Small streets with known boxes, as the detector takes them."""

from __future__ import annotations

import numpy as np

from upvl_cli.detector.batch import FEATURE, Grid, Sample
from upvl_cli.geometry.boxes import corners_bev, points_inside

SMALL = Grid((-12.8, 12.8), (-6.4, 6.4), (-1.0, 4.0), 0.4)
# A parked car, a van that stands across, a truck that looks back, a walker and a rider.
BOXES = np.array(
    [
        [5.1, 3.2, 0.8, 4.4, 1.8, 1.6, 0.1],
        [-3.0, -3.1, 1.0, 5.2, 2.0, 2.0, 1.7],
        [6.5, -3.3, 1.5, 8.0, 2.6, 3.0, 3.0],
        [-7.7, 2.2, 0.9, 0.8, 0.7, 1.8, -1.0],
        [-1.2, 2.9, 0.9, 1.8, 0.7, 1.7, -2.2],
    ]
)


def street(seed: int, boxes: np.ndarray = BOXES, grid: Grid = SMALL) -> Sample:
    """Ground, the sides of each box, and two sweeps; the feature of a point in box b is 1 at b."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(*grid.x_m, 1500), rng.uniform(*grid.y_m, 1500), np.zeros(1500)])
    xyz = np.concatenate([ground, *(_sides(box, rng) for box in boxes)]).astype(np.float32)
    older = rng.uniform(size=len(xyz)) < 0.5
    rest = np.column_stack([rng.uniform(size=(len(xyz), 2)), np.where(older, -0.1, 0)])
    inside = points_inside(xyz, boxes, margin_m=0.02)
    seen = np.flatnonzero(inside.any(axis=0) & ~older)
    feature = np.zeros((len(seen), FEATURE), dtype=np.float32)
    feature[:, : len(boxes)] = inside.T[seen]
    points = np.column_stack([xyz, rest]).astype(np.float32)
    return Sample(points, boxes, seen, feature)


def _sides(box: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(200, 3) points of the four walls of a box; the front wall is the densest, so that it can be told."""
    corner = corners_bev(box[None])[0]
    wall = rng.choice([0, 1, 2, 3], 200, p=[0.2, 0.2, 0.2, 0.4])
    along = rng.uniform(size=(200, 1))
    xy = corner[wall] * along + corner[(wall + 1) % 4] * (1 - along)
    return np.column_stack([xy, box[2] + box[5] * rng.uniform(-0.5, 0.5, 200)])
