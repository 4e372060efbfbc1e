"""Speeds for predictions that have none, by the official rule.

Source: waymo-open-dataset 99a4cb3, metrics/metrics_utils.cc, EstimateObjectSpeed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from upvl_cli.metrics.inputs import Predictions
from upvl_cli.metrics.pairing import Pairing
from upvl_cli.types import Floats


def with_speeds(pairing: Pairing) -> Predictions:
    """Return the predictions, with the speed of the nearest label where a segment gives none.

    A segment gives none where the first prediction of its first frame has none. The official rule looks at
    labels of any type; a frame without labels stands still.

    Args:
        pairing: Predictions and labels by frame.
    """
    velocity = pairing.predictions.velocity_mps.copy()
    guess = False
    for frame, sequence in enumerate(pairing.sequence):
        mine, labels = pairing.predictions_of(frame), pairing.labels_of(frame)
        if frame == 0 or sequence != pairing.sequence[frame - 1]:
            guess = bool(np.isnan(velocity[mine][:1, 0]).any())
        if guess:
            velocity[mine] = _nearest_velocity(pairing, mine, labels)
    return replace(pairing.predictions, velocity_mps=velocity)


def _nearest_velocity(pairing: Pairing, mine: slice, labels: slice) -> Floats:
    """Return (k, 2) velocity of the nearest label of each prediction; of equally near ones the first."""
    centres, velocity = pairing.truth.seven[labels, :3], pairing.truth.velocity_mps[labels]
    if not len(centres):
        return np.zeros((mine.stop - mine.start, 2))
    d = (pairing.predictions.seven[mine, None, :3] - centres).astype(np.float32)
    with np.errstate(over="ignore"):  # infinitely far is far
        squared = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]
    nearest = velocity[np.sqrt(squared).argmin(axis=1)]
    return np.where(np.isnan(nearest), 0.0, nearest)
