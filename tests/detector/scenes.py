"""Small streets with known boxes, as the detector takes them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.detector.config import DecodeConfig, DetectorConfig, GridConfig, TrainConfig
from upvl_cli.detector.data.batch import FEATURE_DIM, Sample
from upvl_cli.detector.grid import Grid
from upvl_cli.detector.heads.anchors import Anchors
from upvl_cli.detector.heads.base import Head
from upvl_cli.detector.heads.centers import Centers
from upvl_cli.geometry.boxes import corners_bev, points_inside
from upvl_cli.types import Boxes

SHIPPED = load(TrainConfig, Path(__file__).parents[2] / "stages" / "train.toml")
CODERS = ("anchors", "centers")
SMALL = GridConfig(-12.8, 12.8, -6.4, 6.4, -1.0, 4.0, 0.4)
DECODING = DecodeConfig(min_score=0.3, max_boxes=10, nms_iou=0.3, candidates_per_box=10)
# A parked car, a van that stands across, a truck that looks back, a walker and a rider.
BOXES = Boxes.from_rows(
    np.array(
        [
            [5.1, 3.2, 0.8, 4.4, 1.8, 1.6, 0.1],
            [-3.0, -3.1, 1.0, 5.2, 2.0, 2.0, 1.7],
            [6.5, -3.3, 1.5, 8.0, 2.6, 3.0, 3.0],
            [-7.7, 2.2, 0.9, 0.8, 0.7, 1.8, -1.0],
            [-1.2, 2.9, 0.9, 1.8, 0.7, 1.7, -2.2],
        ]
    )
)


def small_config(box_coder: str = "anchors", width: int = 8) -> DetectorConfig:
    """A small network on a small grid, all else as it ships."""
    return DetectorConfig(SMALL, replace(SHIPPED.model, box_coder=box_coder, width=width), SHIPPED.sweeps)


def small_head(box_coder: str) -> Head:
    """One of the heads on the small grid, as it ships."""
    grid = Grid.of(SMALL)
    return (
        Anchors(grid, SHIPPED.model.anchors)
        if box_coder == "anchors"
        else Centers(grid, SHIPPED.model.centers)
    )


def shifted(boxes: Boxes, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Boxes:
    """Boxes elsewhere."""
    return Boxes(boxes.center_m + [x, y, z], boxes.size_lwh_m, boxes.heading_rad)


def street(seed: int, boxes: Boxes = BOXES, config: GridConfig = SMALL) -> Sample:
    """Ground, the sides of each box, and two sweeps; the feature of a point in box b is 1 at b."""
    rng, grid = np.random.default_rng(seed), Grid.of(config)
    ground = np.column_stack([rng.uniform(*grid.x_m, 1500), rng.uniform(*grid.y_m, 1500), np.zeros(1500)])
    walls = [_sides(boxes[number : number + 1], rng) for number in range(len(boxes))]
    xyz = np.concatenate([ground, *walls]).astype(np.float32)
    older = rng.uniform(size=len(xyz)) < 0.5
    rest = np.column_stack([rng.uniform(size=(len(xyz), 2)), np.where(older, -0.1, 0)])
    inside = points_inside(xyz, boxes, margin_m=0.02)
    seen = np.flatnonzero(inside.any(axis=0) & ~older)
    feature = np.zeros((len(seen), FEATURE_DIM), dtype=np.float32)
    feature[:, : len(boxes)] = inside.T[seen]
    points = np.column_stack([xyz, rest]).astype(np.float32)
    return Sample(points, boxes, seen, feature)


def _sides(box: Boxes, rng: np.random.Generator) -> np.ndarray:
    """(200, 3) points of the four walls of a box; the front wall is the densest, so that it can be told."""
    corner = corners_bev(box)[0]
    wall = rng.choice([0, 1, 2, 3], 200, p=[0.2, 0.2, 0.2, 0.4])
    along = rng.uniform(size=(200, 1))
    xy = corner[wall] * along + corner[(wall + 1) % 4] * (1 - along)
    return np.column_stack([xy, box.center_m[0, 2] + box.size_lwh_m[0, 2] * rng.uniform(-0.5, 0.5, 200)])
