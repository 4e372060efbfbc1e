"""What becomes of each single box at one score cut-off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.metrics.inputs import Predictions, Truth
from upvl_cli.metrics.matching import Contest
from upvl_cli.metrics.official import Matcher
from upvl_cli.metrics.pairing import can_match, paired
from upvl_cli.metrics.tally import checked_thresholds, kept_until
from upvl_cli.types import Floats, Ints


@dataclass(frozen=True)
class BoxMatches:
    """What became of each box at one cut-off.

    Attributes:
        truth: (m,) the label each prediction is matched with, -1 for none; -2 where the cut-off drops it.
        prediction: (n,) the prediction each label is matched with, -1 for none.
        iou: (m,) IoU with the matched label, 0 for none.
    """

    truth: Ints
    prediction: Ints
    iou: Floats


def match_boxes(
    truth: Truth,
    predictions: Predictions,
    *,
    iou_thresholds: Sequence[float],
    score_cutoff: float,
    matcher: Matcher,
) -> BoxMatches:
    """Return who is matched with whom, each type apart, at one cut-off.

    Args:
        truth: Labels.
        predictions: Boxes.
        iou_thresholds: Least IoU of a match by type, type 0 first.
        score_cutoff: Predictions below are left out.
        matcher: Official rule of matching.

    Raises:
        BadInput: A box or a setting is unusable.
    """
    pairing = paired(truth, predictions)
    reached = can_match(pairing, checked_thresholds(iou_thresholds))
    until = kept_until(pairing.predictions, np.array([score_cutoff]))
    groups = pairing.truth.type - 1, pairing.predictions.type - 1
    each = np.arange(len(pairing.edges))
    matches = Contest(pairing, reached, *groups, until, each, matcher).matches()
    edges = pairing.edges[matches.edge]
    row, label = pairing.prediction_row[edges.prediction], pairing.truth_row[edges.truth]
    of_prediction, of_truth = np.full(len(predictions), -1), np.full(len(truth), -1)
    of_prediction[pairing.prediction_row[until == 0]] = -2
    of_prediction[row], of_truth[label] = label, row
    iou = np.zeros(len(predictions), dtype=np.float32)
    iou[row] = edges.iou
    return BoxMatches(of_prediction, of_truth, iou)
