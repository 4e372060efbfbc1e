"""What the anchors of a batch have to predict: objectness, and the residuals of their boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from upvl_cli.detector.heads.base import RESIDUAL_DIM, Head, encode
from upvl_cli.types import Boxes


@dataclass(frozen=True)
class Targets:
    """What the anchors of a batch have to predict.

    Attributes:
        weight: (b, k) weight of the objectness of each anchor.
        sample: (p,) the sample of each positive anchor.
        anchor: (p,) the positive anchors.
        residual: (p, RESIDUAL_DIM) float32 encoded box of each positive anchor.
    """

    weight: Tensor
    sample: Tensor
    anchor: Tensor
    residual: Tensor

    def to(self, device: torch.device | str) -> Targets:
        """Return the same on another device."""
        return Targets(*(t.to(device) for t in (self.weight, self.sample, self.anchor, self.residual)))


def make_targets(head: Head, boxes: Sequence[Boxes]) -> Targets:
    """Return what the anchors have to predict for the boxes of each sample."""
    return concat_targets([_targets_of_sample(head, of_sample) for of_sample in boxes])


def concat_targets(batches: Sequence[Targets]) -> Targets:
    """Return the targets of batches side by side."""
    first_sample = np.cumsum([0, *(len(batch.weight) for batch in batches)]).tolist()
    return Targets(
        torch.cat([batch.weight for batch in batches]),
        torch.cat([batch.sample + first for batch, first in zip(batches, first_sample, strict=False)]),
        torch.cat([batch.anchor for batch in batches]),
        torch.cat([batch.residual for batch in batches]),
    )


def _targets_of_sample(head: Head, boxes: Boxes) -> Targets:
    assignment = head.assign(boxes)
    residual = encode(head, head.anchors[assignment.anchor], boxes[assignment.box])
    return Targets(
        torch.from_numpy(assignment.weight)[None],
        torch.zeros(len(assignment.anchor), dtype=torch.int64),
        torch.from_numpy(assignment.anchor),
        torch.from_numpy(residual.reshape(-1, RESIDUAL_DIM).astype(np.float32)),
    )
