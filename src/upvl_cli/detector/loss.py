"""What the network has to get right: objectness, boxes, headings, and the features of points.

Each loss is a mean over the samples of what each sample gives alone, so that a batch split evenly over
processes has the mean of their losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from upvl_cli.detector.batch import Batch
from upvl_cli.detector.head import Head
from upvl_cli.detector.model import Detector, Output
from upvl_cli.detector.targets import Targets
from upvl_cli.types import Floats

_ALPHA, _GAMMA = 0.25, 2.0  # focal loss (RetinaNet, Lin et al., ICCV 2017)
_BOX = 2.0  # weight of boxes and headings beside objectness (PointPillars, Lang et al., CVPR 2019)
_BEND = 1 / 9  # where the Huber loss turns straight (SECOND, Yan et al., Sensors 2018)


@dataclass(frozen=True)
class Losses:
    """One number each; `total` is what to go down on, and the others stand in it with their weights.

    Attributes:
        total: Sum.
        objectness: Focal loss.
        box: Huber loss of places and sizes.
        heading: Loss of the headings.
        distil: One less the cosine of told and true features.
    """

    total: Tensor
    objectness: Tensor
    box: Tensor
    heading: Tensor
    distil: Tensor


@dataclass(frozen=True)
class Space:
    """The full space of features, as far as cosines of kept values z need it: cos(m + W'z, m + W'z').

    Attributes:
        square: () m m.
        cross: (64,) W m.
        gram: (64, 64) W W'.
    """

    square: Tensor
    cross: Tensor
    gram: Tensor

    @staticmethod
    def of(mean: Floats, components: Floats) -> Space:
        """From m, (d,), and W, (64, d), of a `Basis`."""
        m, w = (torch.from_numpy(values).to(torch.float64) for values in (mean, components))
        return Space(*(part.float() for part in (m @ m, w @ m, w @ w.T)))

    def to(self, device: torch.device | str) -> Space:
        """The same on another device."""
        return Space(self.square.to(device), self.cross.to(device), self.gram.to(device))

    def cosine(self, a: Tensor, b: Tensor) -> Tensor:
        """(n,) cosine of each row of (n, 64) kept values with the same row of others."""
        dot = self._dot(a, b)
        return dot / (self._dot(a, a) * self._dot(b, b)).clamp(min=1e-12).sqrt()

    def _dot(self, a: Tensor, b: Tensor) -> Tensor:
        return self.square + (a + b) @ self.cross + ((a @ self.gram) * b).sum(dim=1)


def losses(
    detector: Detector, output: Output, batch: Batch, targets: Targets, space: Space, *, distil: float
) -> Losses:
    """How wrong the network is.

    Args:
        detector: What said `output`.
        output: What it said of `batch`.
        batch: Samples.
        targets: What it should have said.
        space: Where features are compared.
        distil: Weight of the features; 0 leaves them out.
    """
    with torch.autocast(output.objectness.device.type, enabled=False):  # losses are summed in full precision
        objectness = objectness_loss(output.objectness, targets)
        box, heading = (_BOX * loss for loss in box_losses(detector.head, output.residual, targets))
        features = objectness.new_zeros(())
        if distil > 0:
            told = detector.features(output, batch, batch.seen)
            of_sample = batch.of_sample[batch.seen]
            features = distil * distil_loss(told, batch.feature, of_sample, batch.size, space)
    return Losses(objectness + box + heading + features, objectness, box, heading, features)


def objectness_loss(said: Tensor, targets: Targets) -> Tensor:
    """Focal loss of (b, k) logits, for each box of a sample."""
    there = torch.zeros_like(said)
    there[targets.sample, targets.place] = 1
    sure = torch.sigmoid(said)
    wrong = there * (1 - sure) + (1 - there) * sure
    balance = there * _ALPHA + (1 - there) * (1 - _ALPHA)
    entropy = functional.binary_cross_entropy_with_logits(said, there, reduction="none")
    each = (balance * wrong**_GAMMA * entropy * targets.weight).sum(dim=1)
    return (each / there.sum(dim=1).clamp(min=1)).mean()


def box_losses(head: Head, said: Tensor, targets: Targets) -> tuple[Tensor, Tensor]:
    """Loss of places and sizes and loss of headings of (b, k, RESIDUAL) numbers, for each box of a sample."""
    mine = said[targets.sample, targets.place]
    place = functional.smooth_l1_loss(mine[:, :6], targets.residual[:, :6], reduction="none", beta=_BEND)
    heading = head.heading_loss(mine[:, 6:], targets.residual[:, 6:])
    size = len(said)
    return _mean(place.sum(dim=1), targets.sample, size), _mean(heading, targets.sample, size)


def distil_loss(told: Tensor, true: Tensor, of_sample: Tensor, size: int, space: Space) -> Tensor:
    """One less the cosine of (r, 64) features in the full space; samples without any count as right."""
    return _mean(1 - space.cosine(told, true), of_sample, size)


def _mean(values: Tensor, of_sample: Tensor, size: int) -> Tensor:
    """Mean over `size` samples of the mean of each one's values, 0 where it has none."""
    count = torch.bincount(of_sample, minlength=size).clamp(min=1)
    return (values.new_zeros(size).index_add(0, of_sample, values) / count).mean()
