"""Speeds for predictions that have none, by the official rule.

Source: waymo-open-dataset 99a4cb3, metrics/metrics_utils.cc, EstimateObjectSpeed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from upvl_cli.metrics.waymo.inputs import Predictions
from upvl_cli.metrics.waymo.pairing import Pairing
from upvl_cli.types import Floats


def estimate_speeds(pairing: Pairing) -> Predictions:
    """Return the predictions, with the speed of the nearest label where a segment gives none.

    A segment gives none where the first prediction of its first frame has none. The official rule looks at
    labels of any type; a frame without labels stands still.

    Args:
        pairing: Predictions and labels by frame.
    """
    velocity = pairing.predictions.velocity_mps.copy()
    is_unset = False
    for frame, sequence in enumerate(pairing.sequence):
        predictions, labels = pairing.predictions_of(frame), pairing.labels_of(frame)
        if frame == 0 or sequence != pairing.sequence[frame - 1]:
            is_unset = bool(np.isnan(velocity[predictions][:1, 0]).any())
        if is_unset:
            velocity[predictions] = _nearest_velocity(pairing, predictions, labels)
    return replace(pairing.predictions, velocity_mps=velocity)


def _nearest_velocity(pairing: Pairing, predictions: slice, labels: slice) -> Floats:
    """Return (k, 2) velocity of the nearest label of each prediction; of equally near ones the first."""
    center_m, velocity = pairing.truth.center_m[labels], pairing.truth.velocity_mps[labels]
    if not len(center_m):
        return np.zeros((predictions.stop - predictions.start, 2))
    d = (pairing.predictions.center_m[predictions, None] - center_m).astype(np.float32)
    with np.errstate(over="ignore"):  # infinitely far is far
        squared = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]
    nearest = velocity[np.sqrt(squared).argmin(axis=1)]
    return np.where(np.isnan(nearest), 0.0, nearest)
