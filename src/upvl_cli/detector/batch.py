"""Frames side by side as the network takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
import torch
from torch import Tensor

from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Bools

FEATURE = 64  # values kept of a feature of the vision-language space (UP-VL, Section 4)
_WHOLE_CELLS = 8  # the network halves its view three times


@dataclass(frozen=True)
class Grid:
    """What the detector sees, in ego axes, metres; seen from above it is cut into square pillars.

    Attributes:
        x_m: Rear and front end.
        y_m: Right and left end.
        z_m: Floor and roof.
        pillar_m: Side of a pillar.
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    z_m: tuple[float, float]
    pillar_m: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("x_m", self.x_m), ("y_m", self.y_m), ("z_m", self.z_m)):
            if not high > low:
                raise BadInput(f"grid {name} goes from {low} to {high}, expected the smaller number first")
        if not self.pillar_m > 0:
            raise BadInput(f"grid pillar_m is {self.pillar_m}, expected more than 0")

    @property
    def shape(self) -> tuple[int, int]:
        """Pillars along x and along y; those added at the far ends to make eights stay empty."""
        along, across = (
            _WHOLE_CELLS * ceil((high - low) / self.pillar_m / _WHOLE_CELLS - 1e-9)
            for low, high in (self.x_m, self.y_m)
        )
        return along, across

    def holds(self, points: Array) -> Bools:
        """(n,) whether each of (n, 3 or more) points x, y, z, ... lies in the grid; far ends are outside."""
        low, high = np.array([self.x_m, self.y_m, self.z_m], dtype=np.float32).T
        return np.asarray(((points[:, :3] >= low) & (points[:, :3] < high)).all(axis=1))


@dataclass(frozen=True)
class Sample:
    """One frame to learn from or to detect in.

    Attributes:
        points: (n, 6) float32 x, y, z (m, ego axes of this frame), intensity, elongation and time after this
            sweep in seconds: 0, or less for an older sweep.
        boxes: (m, 7) float64 auto labels; (0, 7) where there are none.
        feature: (n, 64) float32 kept values of each point's feature; zeros where unknown.
        has_feature: (n,) whether a camera sees the point; points of this sweep only.
    """

    points: Array
    boxes: Array
    feature: Array
    has_feature: Array

    def __post_init__(self) -> None:
        count = len(self.points)
        for name, values, shape in (
            ("points", self.points, (count, 6)),
            ("boxes", self.boxes, (len(self.boxes), 7)),
            ("feature", self.feature, (count, FEATURE)),
            ("has_feature", self.has_feature, (count,)),
        ):
            if values.shape != shape:
                raise BadInput(f"sample: {name} has shape {values.shape}, expected {shape}")


@dataclass(frozen=True)
class Batch:
    """Points of all samples one after the other.

    Attributes:
        points: (n, 6) as in `Sample`; all lie in the grid.
        of_sample: (n,) which sample each point belongs to.
        size: How many samples there are.
        boxes: The (m, 7) float64 labels of each sample; they stay in main memory.
        feature: (n, 64).
        has_feature: (n,).
    """

    points: Tensor
    of_sample: Tensor
    size: int
    boxes: list[Tensor]
    feature: Tensor
    has_feature: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """The same on another device."""
        moved = (t.to(device) for t in (self.points, self.of_sample, self.feature, self.has_feature))
        points, of_sample, feature, has_feature = moved
        return Batch(points, of_sample, self.size, self.boxes, feature, has_feature)


def collate(samples: Sequence[Sample], grid: Grid) -> Batch:
    """Lay samples side by side; points outside of the grid and boxes with their centre outside are left out."""
    inside = [grid.holds(sample.points) for sample in samples]
    of_sample = np.repeat(np.arange(len(samples)), [int(held.sum()) for held in inside])
    pairs = list(zip(samples, inside, strict=True))
    return Batch(
        torch.from_numpy(np.concatenate([s.points[held] for s, held in pairs]).astype(np.float32)),
        torch.from_numpy(of_sample),
        len(samples),
        [torch.from_numpy(s.boxes[grid.holds(s.boxes)].astype(np.float64)) for s in samples],
        torch.from_numpy(np.concatenate([s.feature[held] for s, held in pairs]).astype(np.float32)),
        torch.from_numpy(np.concatenate([s.has_feature[held] for s, held in pairs]).astype(np.bool_)),
    )
