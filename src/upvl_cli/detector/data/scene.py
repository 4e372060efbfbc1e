"""Two sweeps with their labels and features, before they become a `Sample`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.detector.config import SamplingConfig
from upvl_cli.detector.data.batch import Sample
from upvl_cli.detector.grid import Grid
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.types import Array, Boxes, Floats, Ints


@dataclass(frozen=True)
class TrainingScene:
    """Two sweeps with their labels, as they are changed for training.

    Attributes:
        points: (n, 6) as in `Sample`.
        code_of: (n,) row of `codes` that belongs to each point, -1 where none does.
        codes: (c, 64) int8 features of the points that a camera sees.
        boxes: (m) labels, heights above the road.
        velocity_mps: (m, 3) their velocities over the ground along the ego axes.
    """

    points: Array
    code_of: Ints
    codes: Ints
    boxes: Boxes
    velocity_mps: Floats

    @classmethod
    def of_frame(
        cls, points: Array, seen: Ints, codes: Ints, boxes: Boxes, velocity_mps: Floats
    ) -> TrainingScene:
        """Return a scene from the tables of its frame.

        Args:
            points: (n, 6) from `TwoSweeps.points`.
            seen: (c,) the points of this sweep that a camera sees.
            codes: (c, 64) their features.
            boxes: (m) labels, heights above the road.
            velocity_mps: (m, 3) their velocities.
        """
        code_of = np.full(len(points), -1, dtype=np.int32)
        code_of[seen] = np.arange(len(seen))
        return cls(points, code_of, codes, boxes, velocity_mps)

    def sample(
        self,
        grid: Grid,
        values: Callable[[Ints], Floats],
        config: SamplingConfig,
        rng: np.random.Generator,
    ) -> Sample:
        """Return what lies in the grid, as the network takes it, with the features of some of the points.

        Args:
            grid: What the network sees.
            values: Returns the kept values of codes.
            config: How many features, and how many of them in boxes.
            rng: Chooses the points whose features are learned.
        """
        inside = grid.contains(self.points)
        learned = self._draw(np.flatnonzero(inside & (self.code_of >= 0)), config, rng)
        feature = values(self.codes[self.code_of[learned]])
        seen = (np.cumsum(inside) - 1)[learned]
        return Sample(self.points[inside].astype(np.float32, copy=False), self.boxes, seen, feature)

    def _draw(self, seen: Ints, config: SamplingConfig, rng: np.random.Generator) -> Ints:
        """Return some of the points, ascending: a share of them in boxes, where there are any, the rest anywhere.

        Small objects have few points and would hardly count. A box counts as the root of its points, by repetition.
        """
        total = config.features_per_frame
        box, held = pairs_inside(self.points[seen, :3], self.boxes, margin_m=0.0)
        odds = 1 / np.sqrt(np.bincount(box)[box])
        in_boxes = int(config.box_share * total)
        from_boxes = rng.choice(seen[held], in_boxes, p=odds / odds.sum()) if len(held) else held
        rest = total - len(from_boxes)
        anywhere = rng.choice(seen, rest, replace=False, shuffle=False) if len(seen) > rest else seen
        return np.sort(np.concatenate([from_boxes, anywhere]))
