"""How well headings agree, in the float32 steps of the official tool.

Source: waymo-open-dataset 99a4cb3, metrics/metrics_utils.cc, ComputeHeadingAccuracy.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Floats


def heading_accuracy(prediction_rad: Floats, truth_rad: Floats) -> Floats:
    """Return (k,) float32 accuracy of headings: 1 for equal, 0 for opposite ones.

    Args:
        prediction_rad: (k,) headings of predictions, any turn.
        truth_rad: (k,) headings of labels.
    """
    difference = np.abs(_wrap(prediction_rad) - _wrap(truth_rad)).astype(np.float64)
    difference = np.where(difference > np.pi, np.float32(2 * np.pi - difference), difference)
    return np.clip(1 - difference / np.pi, 0, 1).astype(np.float32)


def _wrap(angle_rad: Floats) -> Floats:
    """Return float32 angles in [-pi, pi), rounded as the official tool rounds them."""
    shifted = angle_rad + np.pi
    turn = 2 * np.pi
    rest = shifted - np.trunc(shifted * (1 / turn)) * turn
    up = np.where(turn + rest >= turn, 0.0, turn + rest)
    return np.asarray(np.where(rest >= 0, rest, up) - np.pi, dtype=np.float32)
