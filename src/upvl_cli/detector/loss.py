"""Losses of the network: objectness, boxes, headings, and the features of points.

Each loss is a mean over the samples of what each sample gives alone, so that a batch split evenly over
processes has the mean of their losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from upvl_cli.detector.config import DistillationConfig, LossConfig
from upvl_cli.detector.data.batch import Batch
from upvl_cli.detector.heads.base import BOX_DIMS, HEADING_DIMS, Head
from upvl_cli.detector.model import Detector, Output
from upvl_cli.detector.targets import Targets
from upvl_cli.types import Floats


@dataclass(frozen=True)
class Losses:
    """One number each; `total` is minimized, and the others stand in it with their weights.

    Attributes:
        total: Sum of the others.
        objectness: Focal loss.
        box: Huber loss of centres and sizes.
        heading: Loss of the headings.
        distillation: Cosine distance of predicted features to those of the pictures.
    """

    total: Tensor
    objectness: Tensor
    box: Tensor
    heading: Tensor
    distillation: Tensor


@dataclass(frozen=True)
class FeatureSpace:
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
    def from_basis(mean: Floats, components: Floats) -> FeatureSpace:
        """Return the space of m, (d,), and W, (64, d), of a `Basis`."""
        m, w = (torch.from_numpy(values).to(torch.float64) for values in (mean, components))
        return FeatureSpace(*(part.float() for part in (m @ m, w @ m, w @ w.T)))

    def to(self, device: torch.device | str) -> FeatureSpace:
        """Return the same on another device."""
        return FeatureSpace(self.square.to(device), self.cross.to(device), self.gram.to(device))

    def cosine(self, a: Tensor, b: Tensor) -> Tensor:
        """Return (n,) cosines of each row of (n, 64) kept values with the same row of others."""
        dot = self._dot(a, b)
        return dot / (self._dot(a, a) * self._dot(b, b)).clamp(min=1e-12).sqrt()

    def _dot(self, a: Tensor, b: Tensor) -> Tensor:
        return self.square + (a + b) @ self.cross + ((a @ self.gram) * b).sum(dim=1)


@dataclass(frozen=True)
class Criterion:
    """What the losses are computed with.

    Attributes:
        space: Where features are compared.
        boxes: Settings of the losses of boxes.
        distillation: Settings of the loss of features; it counts where the network predicts features.
    """

    space: FeatureSpace
    boxes: LossConfig
    distillation: DistillationConfig


def losses(
    detector: Detector, output: Output, batch: Batch, targets: Targets, criterion: Criterion
) -> Losses:
    """Return the losses of a batch.

    Args:
        detector: The network that gave `output`.
        output: Its output for `batch`.
        batch: Samples.
        targets: What the anchors have to predict.
        criterion: Weights, and where features are compared.
    """
    config = criterion.boxes
    with torch.autocast(output.objectness.device.type, enabled=False):  # losses are summed in full precision
        objectness = objectness_loss(output.objectness, targets, config)
        box, heading = (
            config.box_weight * loss for loss in box_losses(detector.head, output.residual, targets, config)
        )
        distillation = objectness.new_zeros(())
        if detector.distillation_head is not None:
            prediction = detector.features(output, batch, batch.seen)
            distance = distillation_loss(
                prediction, batch.feature, batch.of_sample[batch.seen], batch.size, criterion.space
            )
            distillation = criterion.distillation.weight * distance
    return Losses(objectness + box + heading + distillation, objectness, box, heading, distillation)


def objectness_loss(prediction: Tensor, targets: Targets, config: LossConfig) -> Tensor:
    """Return the focal loss of (b, k) logits, per box of a sample (RetinaNet, Lin et al., ICCV 2017, eq. 5)."""
    positive = torch.zeros_like(prediction)
    positive[targets.sample, targets.anchor] = 1
    probability = torch.sigmoid(prediction)
    error = positive * (1 - probability) + (1 - positive) * probability  # 1 - p_t
    alpha = positive * config.focal_alpha + (1 - positive) * (1 - config.focal_alpha)
    entropy = functional.binary_cross_entropy_with_logits(prediction, positive, reduction="none")
    of_sample = (alpha * error**config.focal_gamma * entropy * targets.weight).sum(dim=1)
    return (of_sample / positive.sum(dim=1).clamp(min=1)).mean()


def box_losses(head: Head, prediction: Tensor, targets: Targets, config: LossConfig) -> tuple[Tensor, Tensor]:
    """Return the losses of boxes and of headings of (b, k, RESIDUAL_DIM) residuals, per box of a sample."""
    positive = prediction[targets.sample, targets.anchor]
    box = functional.smooth_l1_loss(
        positive[:, BOX_DIMS], targets.residual[:, BOX_DIMS], reduction="none", beta=config.huber_delta
    )
    heading = head.heading_loss(positive[:, HEADING_DIMS], targets.residual[:, HEADING_DIMS])
    size = len(prediction)
    return (
        _mean_of_samples(box.sum(dim=1), targets.sample, size),
        _mean_of_samples(heading, targets.sample, size),
    )


def distillation_loss(
    prediction: Tensor, target: Tensor, of_sample: Tensor, size: int, space: FeatureSpace
) -> Tensor:
    """Return the cosine distance of (r, 64) features in the full space (UP-VL, Section 3.4); 0 without any."""
    return _mean_of_samples(1 - space.cosine(prediction, target), of_sample, size)


def _mean_of_samples(values: Tensor, of_sample: Tensor, size: int) -> Tensor:
    """Return the mean over `size` samples of the mean of each one's values, 0 where it has none."""
    count = torch.bincount(of_sample, minlength=size).clamp(min=1)
    return (values.new_zeros(size).index_add(0, of_sample, values) / count).mean()
