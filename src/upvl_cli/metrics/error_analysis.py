"""Analysis of errors: why false positives are false, and which labels are missed.

The split of the false positives is that of Hoiem et al., Diagnosing Error in Object Detectors, ECCV 2012,
with the numbers of Najibi et al., Unsupervised 3D Perception with 2D Vision-Language Distillation for
Autonomous Driving, ICCV 2023: an overlap counts above IoU 0.1, a box is right from IoU 0.4 on, and only the
best-scored boxes of a type are looked at, half as many as the type has labels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, map_types
from upvl_cli.metrics.waymo.official import TYPES
from upvl_cli.metrics.waymo.pairing import pair_frames
from upvl_cli.types import Array, Bools, Ints


class Outcome(IntEnum):
    """Kind of a prediction, after Hoiem et al."""

    RIGHT = 0
    LOCALISATION = 1
    OTHER_CLASS = 2
    BACKGROUND = 3


@dataclass(frozen=True)
class TopOutcomes:
    """Kinds of the best-scored predictions of a type.

    Attributes:
        type: Their type: VEHICLE 1, PEDESTRIAN 2, SIGN 3, CYCLIST 4.
        labels: How many labels the type has.
        right: Predictions that are matched with a label.
        localisation: False ones that overlap a label of their type: misplaced, or a second box for it.
        other_class: False ones that overlap labels of other types only.
        background: False ones that overlap no label.
    """

    type: int
    labels: int
    right: int
    localisation: int
    other_class: int
    background: int


@dataclass(frozen=True)
class MissedLabels:
    """Number of labels of one group, and how many of them are missed.

    Attributes:
        split: "points", "range", "view" or "speed".
        group: Which labels, for example "[30, 50) m".
        labels: How many there are.
        missed: How many of them no prediction is matched with.
    """

    split: str
    group: str
    labels: int
    missed: int


def classify_predictions(
    truth: Truth, predictions: Predictions, matched: Bools, *, min_overlap_iou: float
) -> Ints:
    """Return (m,) the `Outcome` of each prediction.

    Args:
        truth: All labels, also those of other types.
        predictions: Boxes of the same segments.
        matched: (m,) whether a label is matched with each prediction, at the IoU that makes a box right.
        min_overlap_iou: A 3D IoU up to this is no overlap.
    """
    same, other = _best_iou(truth, predictions)
    false = np.select(
        [same > min_overlap_iou, other > min_overlap_iou],
        [Outcome.LOCALISATION, Outcome.OTHER_CLASS],
        Outcome.BACKGROUND,
    )
    return np.where(matched, Outcome.RIGHT, false).astype(np.int64)


def count_top_outcomes(
    truth: Truth, predictions: Predictions, outcome: Ints, *, top_share: float
) -> list[TopOutcomes]:
    """Return the kinds of the best predictions, for each type that has a label or a prediction.

    Where labels are incomplete (`unlabelled`) a prediction without a match is not looked at. Equal scores
    keep the order of the predictions.

    Args:
        truth: All labels.
        predictions: Boxes of the same segments.
        outcome: (m,) the `Outcome` of each prediction.
        top_share: How many predictions to look at, as a share of the labels of the type; rounded up.
    """
    judged = (outcome == Outcome.RIGHT) | ~predictions.unlabelled
    result = []
    for number in range(1, len(TYPES)):
        labels = int((truth.type == number).sum())
        of_type = np.flatnonzero((predictions.type == number) & judged)
        best = of_type[np.argsort(-predictions.score[of_type], kind="stable")][
            : math.ceil(top_share * labels)
        ]
        if labels or len(of_type):
            counts = np.bincount(outcome[best], minlength=len(Outcome)).tolist()
            result.append(TopOutcomes(number, labels, *counts))
    return result


def count_missed_labels(
    found: Bools,
    *,
    points: Array,
    range_m: Array,
    in_view: Array,
    point_edges: Sequence[int],
    range_edges_m: Sequence[float],
) -> list[MissedLabels]:
    """Return how many labels are missed, split by points, by range and by view; empty groups too.

    Args:
        found: (n,) whether a prediction is matched with each label.
        points: (n,) LiDAR points inside each label, -1 where unknown.
        range_m: (n,) distance of each label from the car.
        in_view: (n,) whether a camera sees each label.
        point_edges: Ascending; groups are from one to below the next, with one below all and one above.
        range_edges_m: The same for the range, in metres.

    Raises:
        BadInput: The arrays are of different lengths, or edges do not ascend or are none.
    """
    found, in_view = np.asarray(found, dtype=np.bool_), np.asarray(in_view, dtype=np.bool_)
    points, range_m = np.asarray(points, dtype=np.float64), np.asarray(range_m, dtype=np.float64)
    lengths = {len(values) for values in (found, points, range_m, in_view)}
    if len(lengths) > 1:
        raise BadInput(f"labels to split have arrays of different lengths: {sorted(lengths)}")
    known = np.where(points < 0, np.nan, points)
    return [
        *_missed_by_edges("points", known, point_edges, "points", found),
        *_missed_by_edges("range", range_m, range_edges_m, "m", found),
        MissedLabels("view", "in view", int(in_view.sum()), int((in_view & ~found).sum())),
        MissedLabels("view", "out of view", int((~in_view).sum()), int((~in_view & ~found).sum())),
    ]


def _best_iou(truth: Truth, predictions: Predictions) -> tuple[Array, Array]:
    """Return (m,) the largest IoU with a label of the same type, and with one of another type."""
    all_one = dict.fromkeys(range(len(TYPES)), 1)
    pairing = pair_frames(map_types(truth, all_one), map_types(predictions, all_one))
    row = pairing.prediction_row[pairing.edges.prediction]
    same_type = predictions.type[row] == truth.type[pairing.truth_row[pairing.edges.truth]]
    same, other = np.zeros(len(predictions)), np.zeros(len(predictions))
    np.maximum.at(same, row[same_type], pairing.edges.iou[same_type])
    np.maximum.at(other, row[~same_type], pairing.edges.iou[~same_type])
    return same, other


def _missed_by_edges(
    name: str, values: Array, edges: Sequence[float], unit: str, found: Bools
) -> list[MissedLabels]:
    """Return a group below the edges, one between each two, one above, and one for NaN if there is any."""
    if not len(edges) or not (np.diff(edges) > 0).all():
        raise BadInput(f"edges of {name} must ascend, at least one of them; got {list(edges)}")
    group = np.where(np.isnan(values), len(edges) + 1, np.searchsorted(edges, values, side="right"))
    labels = np.bincount(group, minlength=len(edges) + 2)
    missed = np.bincount(group[~found], minlength=len(edges) + 2)
    between = [f"[{low:g}, {high:g}) {unit}" for low, high in zip(edges, edges[1:], strict=False)]
    names = [f"below {edges[0]:g} {unit}", *between, f"from {edges[-1]:g} {unit}", "unknown"]
    rows = zip(names, labels.tolist(), missed.tolist(), strict=True)
    return [MissedLabels(name, *row) for row in rows if row[0] != "unknown" or row[1]]
