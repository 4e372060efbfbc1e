"""Samples, and batches of them as the network takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from upvl_cli.detector.grid import Grid
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Boxes, Ints, empty

FEATURE_DIM = 64  # values kept of a feature of the vision-language space (UP-VL, Section 4)
TIME_DIM = 5  # column of the points that holds their time


@dataclass(frozen=True)
class Sample:
    """One frame to learn from or to detect in.

    Attributes:
        points: (n, 6) float32 x, y, z (m, ego axes of this frame, heights above the road), intensity, elongation
            and time after this sweep in seconds: 0, or less for an older sweep.
        boxes: (m) auto labels; none where there are none.
        seen: (s,) ascending indices of points that a camera sees, as many as are to be learned from; of this
            sweep only.
        feature: (s, 64) float32 kept values of their features.
    """

    points: Array
    boxes: Boxes
    seen: Ints
    feature: Array

    @staticmethod
    def from_points(points: Array) -> Sample:
        """Return a frame to detect in, of (n, 6) points alone."""
        feature = np.zeros((0, FEATURE_DIM), dtype=np.float32)
        return Sample(points, empty(Boxes), np.zeros(0, dtype=np.int64), feature)

    def __post_init__(self) -> None:
        for name, values, shape in (
            ("points", self.points, (len(self.points), 6)),
            ("seen", self.seen, (len(self.seen),)),
            ("feature", self.feature, (len(self.seen), FEATURE_DIM)),
        ):
            if values.shape != shape:
                raise BadInput(f"sample: {name} has shape {values.shape}, expected {shape}")


@dataclass(frozen=True)
class Batch:
    """Points of all samples one after the other.

    Attributes:
        points: (n, 6) as in `Sample`; all lie in the grid.
        of_sample: (n,) the sample of each point.
        size: How many samples there are.
        boxes: The labels of each sample.
        seen: (s,) the points that have a feature.
        feature: (s, 64) features of those.
    """

    points: Tensor
    of_sample: Tensor
    size: int
    boxes: list[Boxes]
    seen: Tensor
    feature: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """Return the same on another device; boxes stay in main memory."""
        moved = (t.to(device) for t in (self.points, self.of_sample, self.seen, self.feature))
        points, of_sample, seen, feature = moved
        return Batch(points, of_sample, self.size, self.boxes, seen, feature)


def collate(samples: Sequence[Sample], grid: Grid) -> Batch:
    """Return samples side by side, without points outside of the grid and boxes with their centre outside."""
    return concat_batches([_batch_of_sample(sample, grid) for sample in samples])


def concat_batches(batches: Sequence[Batch]) -> Batch:
    """Return batches side by side."""
    first_point = np.cumsum([0, *(len(batch.points) for batch in batches)]).tolist()
    first_sample = np.cumsum([0, *(batch.size for batch in batches)]).tolist()
    return Batch(
        torch.cat([batch.points for batch in batches]),
        torch.cat([batch.of_sample + first for batch, first in zip(batches, first_sample, strict=False)]),
        first_sample[-1],
        [boxes for batch in batches for boxes in batch.boxes],
        torch.cat([batch.seen + first for batch, first in zip(batches, first_point, strict=False)]),
        torch.cat([batch.feature for batch in batches]),
    )


def _batch_of_sample(sample: Sample, grid: Grid) -> Batch:
    inside = grid.contains(sample.points)
    stays = inside[sample.seen]
    new_index = np.cumsum(inside) - 1
    points = sample.points[inside].astype(np.float32, copy=False)
    return Batch(
        torch.from_numpy(points),
        torch.zeros(len(points), dtype=torch.int64),
        1,
        [sample.boxes[grid.contains(sample.boxes.center_m)]],
        torch.from_numpy(new_index[sample.seen[stays]].astype(np.int64, copy=False)),
        torch.from_numpy(sample.feature[stays].astype(np.float32, copy=False)),
    )
