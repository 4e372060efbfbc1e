"""How well boxes enclose the points of their objects, for any meaning of the numbers of a label."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.perception.drive_check.label_config import LabelCheckConfig
from upvl_cli.perception.drive_check.sample import DriveSample
from upvl_cli.types import Array, Boxes, Floats, Ints, Labels

Meaning = Callable[[Boxes, int], Boxes]  # boxes of a step as they are, to what they mean


@dataclass(frozen=True)
class BoxFit:
    """Labels of a few frames and the points above the road of these and their neighbours.

    Attributes:
        labels: Those that are looked at, by step.
        points: (m, 3) points above the road, by step.
        objects: Number of the object of each label, over all steps in ascending order.
        config: Margins.
    """

    labels: dict[int, Boxes]
    points: dict[int, Array]
    objects: Ints
    config: LabelCheckConfig

    @classmethod
    def build(cls, labels: Labels, sample: DriveSample, config: LabelCheckConfig) -> BoxFit:
        """Choose the frames, and remove the road from their sweeps."""
        step_of = {frame.index: step for step, frame in enumerate(sample.frames)}
        steps = sorted({step_of[frame] for frame in labels.frame.tolist() if frame in step_of})
        places = np.linspace(0, len(steps) - 1, min(config.frames, len(steps))).round().astype(int)
        chosen: dict[int, Boxes] = {}
        names: list[str] = []
        for step in sorted({steps[place] for place in places}):
            here = labels[labels.frame == sample.frames[step].index]
            chosen[step] = Boxes(here.center_m, here.size_lwh_m, here.heading_rad)
            names += here.object_id.tolist()
        total = len(sample.frames)
        near = {other for step in chosen for other in (step - 1, step, step + 1) if 0 <= other < total}
        points = {step: above_road(sample.sweep(step).xyz_ego_m, config) for step in sorted(near)}
        objects = np.unique(names, return_inverse=True)[1] if names else np.zeros(0, dtype=np.int64)
        return cls(chosen, points, np.asarray(objects, dtype=np.int64), config)

    def shares(self, meaning: Meaning, shift: int = 0) -> Floats:
        """Return (n,) share of the points around each box that lie inside; 0 where there are none.

        Args:
            meaning: What the boxes mean.
            shift: Steps by which their sweep is later.
        """
        parts = []
        for step, given in self.labels.items():
            xyz = self.points.get(step + shift)
            boxes = meaning(given, step)
            if xyz is None:
                parts.append(np.full(len(boxes), np.nan))
                continue
            inside, around = (
                np.bincount(pairs_inside(xyz, boxes, margin_m=margin)[0], minlength=len(boxes))
                for margin in (self.config.inner_m, self.config.outer_m)
            )
            share = inside / np.maximum(around, 1)
            parts.append(np.where(around >= self.config.min_points, share, 0.0))
        return np.concatenate(parts) if parts else np.zeros(0)

    def near(self) -> Array:
        """Return (n,) whether each box lies near the car, as it is given."""
        far_m = [np.linalg.norm(boxes.center_m[:, :2], axis=1) for boxes in self.labels.values()]
        return np.asarray(np.concatenate(far_m) < self.config.reach_m) if far_m else np.zeros(0, dtype=bool)


def above_road(xyz_ego_m: Array, config: LabelCheckConfig) -> Array:
    """Return (m, 3) the points that stand above the lowest point around them."""
    xyz = np.asarray(xyz_ego_m, dtype=np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1) & (np.abs(xyz[:, :2]) < config.reach_m).all(axis=1)]
    count = int(2 * config.reach_m / config.ground_cell_m) + 3
    cell = ((xyz[:, :2] + config.reach_m) / config.ground_cell_m).astype(int) + 1
    lowest_m = np.full((count, count), np.inf)
    np.minimum.at(lowest_m, tuple(cell.T), xyz[:, 2])
    return np.asarray(xyz[xyz[:, 2] > lowest_m[tuple(cell.T)] + config.ground_m])
