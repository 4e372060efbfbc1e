"""Hypotheses of one sweep in one list of boxes: clusters of several radii, and which of them are the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.clustering import NOISE
from upvl_cli.perception.proposals.propose import Proposals
from upvl_cli.types import Array, Boxes, Floats, Ints, Ragged, concat

NO_DUPLICATE = -1


@dataclass(frozen=True)
class HypothesisBoxes:
    """The boxes of all hypotheses of one sweep, those of the first one first.

    Attributes:
        boxes: k boxes.
        velocity_mps: (k, 3) velocity of each.
        num_points: (k,) number of points that each was fitted to.
        hypothesis: (k,) number of the hypothesis of each.
        duplicate_of: (k,) row of the box of an earlier hypothesis with nearly the same points; -1 for none.
        point_index: Numbers of the points of each, ascending.
    """

    boxes: Boxes
    velocity_mps: Array
    num_points: Ints
    hypothesis: Ints
    duplicate_of: Ints
    point_index: Ragged


def join_hypotheses(
    hypotheses: Sequence[Proposals], number: Ints, *, duplicate_iou: float
) -> HypothesisBoxes:
    """Return the boxes of all hypotheses of a sweep.

    Duplicates stay: without them the tracks of a later hypothesis would have gaps wherever both agree.

    Args:
        hypotheses: The boxes of each hypothesis, at least one.
        number: (n,) number of each point, as `point_index` is to hold them.
        duplicate_iou: Shared points over the points of both from which on a box is a duplicate.
    """
    counts = [len(found.boxes) for found in hypotheses]
    starts = np.concatenate([[0], np.cumsum(counts)])
    duplicate_of: Ints = np.full(starts[-1], NO_DUPLICATE, dtype=np.int64)
    for later in range(1, len(hypotheses)):
        best: Floats = np.zeros(counts[later])
        here = duplicate_of[starts[later] : starts[later + 1]]
        for earlier in range(later):
            box, other, iou = _overlaps(hypotheses[later].box_of_point, hypotheses[earlier].box_of_point)
            better = (iou >= duplicate_iou) & (iou > best[box])
            order = np.argsort(iou[better], kind="stable")  # the largest is written last
            best[box[better][order]] = iou[better][order]
            here[box[better][order]] = starts[earlier] + other[better][order]
    points = [
        Ragged.grouped(found.box_of_point, number, count)
        for found, count in zip(hypotheses, counts, strict=True)
    ]
    return HypothesisBoxes(
        concat([found.boxes for found in hypotheses], Boxes),
        np.concatenate([found.velocity_mps for found in hypotheses]),
        np.concatenate([found.num_points for found in hypotheses]),
        np.repeat(np.arange(len(hypotheses)), counts),
        duplicate_of,
        Ragged(
            np.concatenate([part.values for part in points]), np.concatenate([part.count for part in points])
        ),
    )


def _overlaps(label: Ints, other: Ints) -> tuple[Ints, Ints, Floats]:
    """Return the pairs of clusters of two labellings that share points, and the share of all points of both."""
    count, other_count = (np.bincount(part[part != NOISE]) for part in (label, other))
    in_both = (label != NOISE) & (other != NOISE)
    width = max(len(other_count), 1)
    pair, shared = np.unique(label[in_both] * width + other[in_both], return_counts=True)
    first, second = pair // width, pair % width
    return first, second, shared / (count[first] + other_count[second] - shared)
