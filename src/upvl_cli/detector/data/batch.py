"""Frames side by side as the network takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
import torch
from torch import Tensor

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.types import Array, Bools, Ints

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
        inside = np.ones(len(points), dtype=np.bool_)
        for axis, (low, high) in enumerate((self.x_m, self.y_m, self.z_m)):
            values = np.ascontiguousarray(points[:, axis])
            inside &= (values >= low) & (values < high)
        return inside


@dataclass(frozen=True)
class Sample:
    """One frame to learn from or to detect in.

    Attributes:
        points: (n, 6) float32 x, y, z (m, ego axes of this frame), intensity, elongation and time after this
            sweep in seconds: 0, or less for an older sweep.
        boxes: (m, 7) float64 auto labels; (0, 7) where there are none.
        seen: (s,) ascending rows of points that a camera sees, as many as are to be learned from; of this
            sweep only.
        feature: (s, 64) float32 kept values of their features.
    """

    points: Array
    boxes: Array
    seen: Ints
    feature: Array

    @staticmethod
    def of_points(points: Array) -> Sample:
        """A frame to detect in: nothing is known of it but its (n, 6) points."""
        none = np.zeros((0, FEATURE), dtype=np.float32)
        return Sample(points, np.zeros((0, 7)), np.zeros(0, dtype=np.int64), none)

    def __post_init__(self) -> None:
        for name, values, shape in (
            ("points", self.points, (len(self.points), 6)),
            ("boxes", self.boxes, (len(self.boxes), 7)),
            ("seen", self.seen, (len(self.seen),)),
            ("feature", self.feature, (len(self.seen), FEATURE)),
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
        seen: (s,) which points have a feature.
        feature: (s, 64) features of those.
    """

    points: Tensor
    of_sample: Tensor
    size: int
    boxes: list[Tensor]
    seen: Tensor
    feature: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """The same on another device."""
        moved = (t.to(device) for t in (self.points, self.of_sample, self.seen, self.feature))
        points, of_sample, seen, feature = moved
        return Batch(points, of_sample, self.size, self.boxes, seen, feature)


def collate(samples: Sequence[Sample], grid: Grid) -> Batch:
    """Lay samples side by side; points outside of the grid and boxes with their centre outside are left out."""
    return joined([_alone(sample, grid) for sample in samples])


def joined(batches: Sequence[Batch]) -> Batch:
    """Lay batches side by side."""
    points = np.cumsum([0, *(len(batch.points) for batch in batches)]).tolist()
    samples = np.cumsum([0, *(batch.size for batch in batches)]).tolist()
    return Batch(
        torch.cat([batch.points for batch in batches]),
        torch.cat([batch.of_sample + before for batch, before in zip(batches, samples, strict=False)]),
        samples[-1],
        [boxes for batch in batches for boxes in batch.boxes],
        torch.cat([batch.seen + before for batch, before in zip(batches, points, strict=False)]),
        torch.cat([batch.feature for batch in batches]),
    )


def _alone(sample: Sample, grid: Grid) -> Batch:
    inside = grid.holds(sample.points)
    stays = inside[sample.seen]
    row = np.cumsum(inside) - 1  # where each point that stays comes to lie
    points = sample.points[inside].astype(np.float32, copy=False)
    return Batch(
        torch.from_numpy(points),
        torch.zeros(len(points), dtype=torch.int64),
        1,
        [torch.from_numpy(sample.boxes[grid.holds(sample.boxes)].astype(np.float64))],
        torch.from_numpy(row[sample.seen[stays]].astype(np.int64, copy=False)),
        torch.from_numpy(sample.feature[stays].astype(np.float32, copy=False)),
    )


def grid_of(grid_m: Array | tuple[float, ...], pillar_m: float) -> Grid:
    """Return what the detector sees, from the numbers of the settings.

    Raises:
        BadSetting: There are not six of them.
    """
    if len(grid_m) != 6:
        raise BadSetting(f"train: grid_m has {len(grid_m)} numbers, expected 6: x from and to, y, height")
    x0, x1, y0, y1, z0, z1 = (float(end) for end in grid_m)
    return Grid((x0, x1), (y0, y1), (z0, z1), pillar_m)
