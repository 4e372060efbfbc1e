"""3D average precision as the Waymo Open Dataset's detection tool computes it.

Source: waymo-open-dataset 99a4cb3, metrics/detection_metrics.cc. Matching uses all labels, whatever the
level; a level only decides which unmatched labels count as missed. The tool's rule for levels and for
labels without points is the caller's: `inputs.resolve_level`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.metrics.waymo.average_precision import average_precision
from upvl_cli.metrics.waymo.breakdown import Breakdown
from upvl_cli.metrics.waymo.heading import heading_accuracy
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.matching import Matches, MatchingProblem
from upvl_cli.metrics.waymo.official import LEVELS, NEAR_IOU, TYPES, Matcher
from upvl_cli.metrics.waymo.pairing import Pairing, can_match, pair_frames
from upvl_cli.metrics.waymo.tally import (
    check_thresholds,
    count_missed,
    count_spans,
    cutoffs_kept,
    key_numbers,
)
from upvl_cli.types import Array, Bools, Floats, Ints


@dataclass(frozen=True)
class DetectionResult:
    """Scores of one shard at one level; arrays hold one value a cut-off.

    Attributes:
        name: Shard and level as the official tool names them.
        level: 1 or 2.
        ap: Average precision, 0 without labels.
        aph: The same with each match weighted by the accuracy of its heading.
        tp: (c,) matched predictions.
        fp: (c,) false predictions.
        fn: (c,) labels missed.
        sum_ha: (c,) float32 sum of the heading accuracies of the matches.
        precision: (c,) float32 share of right predictions; 1 where the recall is 0.
        precision_ha: (c,) float32, the same weighted by heading.
        recall: (c,) float32 share of labels found.
    """

    name: str
    level: int
    ap: float
    aph: float
    tp: Ints
    fp: Ints
    fn: Ints
    sum_ha: Floats
    precision: Floats
    precision_ha: Floats
    recall: Floats


@dataclass(frozen=True)
class BoxMatches:
    """The match of each box at one cut-off.

    Attributes:
        truth: (m,) the label each prediction is matched with, -1 for none; -2 where the cut-off drops it.
        prediction: (n,) the prediction each label is matched with, -1 for none.
        iou: (m,) IoU with the matched label, 0 for none.
    """

    truth: Ints
    prediction: Ints
    iou: Floats


@dataclass(frozen=True)
class _Counts:
    """(s, c) counts of all shards; missed labels by level."""

    tp: Ints
    fp: Ints
    fn: Mapping[int, Ints]
    sum_ha: Floats


def detection(
    truth: Truth,
    predictions: Predictions,
    *,
    iou_thresholds: Sequence[float],
    breakdowns: Sequence[Breakdown],
    score_cutoffs: Array,
    matcher: Matcher,
) -> list[DetectionResult]:
    """Return the scores in the official order: breakdown, shard, level.

    Args:
        truth: Labels; level as resolved.
        predictions: Boxes of any frames, also such as have no label.
        iou_thresholds: Minimum IoU of a match by type, type 0 first.
        breakdowns: Ways to split the boxes.
        score_cutoffs: (c,) ascending.
        matcher: Official rule of matching; the tools use "hungarian".

    Raises:
        BadInput: A box or a setting is unusable.
    """
    pairing = pair_frames(truth, predictions)
    reached = can_match(pairing, check_thresholds(iou_thresholds))
    until = cutoffs_kept(pairing.predictions, score_cutoffs)
    results = []
    for breakdown in breakdowns:
        counts = _count(pairing, reached, until, breakdown, len(score_cutoffs), matcher)
        for shard, name in enumerate(breakdown.shards):
            results += [_result(f"{name}_LEVEL_{level}", level, shard, counts) for level in LEVELS]
    return results


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
        iou_thresholds: Minimum IoU of a match by type, type 0 first.
        score_cutoff: Predictions below are left out.
        matcher: Official rule of matching.

    Raises:
        BadInput: A box or a setting is unusable.
    """
    pairing = pair_frames(truth, predictions)
    reached = can_match(pairing, check_thresholds(iou_thresholds))
    until = cutoffs_kept(pairing.predictions, np.array([score_cutoff]))
    groups = pairing.truth.type - 1, pairing.predictions.type - 1
    each = np.arange(len(pairing.edges))
    matches = MatchingProblem(pairing, reached, *groups, until, each, matcher).matches()
    edges = pairing.edges[matches.edge]
    row, label = pairing.prediction_row[edges.prediction], pairing.truth_row[edges.truth]
    of_prediction, of_truth = np.full(len(predictions), -1), np.full(len(truth), -1)
    of_prediction[pairing.prediction_row[until == 0]] = -2
    of_prediction[row], of_truth[label] = label, row
    iou = np.zeros(len(predictions), dtype=np.float32)
    iou[row] = edges.iou
    return BoxMatches(of_prediction, of_truth, iou)


def _count(
    pairing: Pairing, reached: Bools, until: Ints, breakdown: Breakdown, cutoffs: int, matcher: Matcher
) -> _Counts:
    """Return the counts of all shards of one breakdown."""
    truth, predictions, shape = pairing.truth, pairing.predictions, (len(breakdown.shards), cutoffs)
    shard = breakdown.shard_of(truth)
    if breakdown.types_apart:
        false_shards = _false_shards(pairing, shard, len(breakdown.shards) // len(TYPES[1:]))
        groups = truth.type - 1, predictions.type - 1
    else:
        false_shards = [breakdown.shard_of(predictions)]
        groups = shard, false_shards[0]
    accuracy = heading_accuracy(
        predictions.heading_rad[pairing.edges.prediction], truth.heading_rad[pairing.edges.truth]
    )
    kind = _kinds(pairing, shard, accuracy)
    matches = MatchingProblem(pairing, reached, *groups, until, kind, matcher).matches()
    edges = pairing.edges[matches.edge]
    hit = shard[edges.truth]
    fp = np.zeros(shape, dtype=np.int64)
    for shard_if_false in false_shards:
        at = np.where(predictions.unlabelled, -1, shard_if_false)
        fp += count_spans(at, np.zeros_like(until), until, shape)
        fp -= count_spans(at[edges.prediction], matches.since, matches.until, shape)
    return _Counts(
        count_spans(hit, matches.since, matches.until, shape),
        fp,
        {level: count_missed(truth, shard, edges, matches, level, shape) for level in LEVELS},
        _sum_ha(pairing, matches, hit, accuracy[matches.edge], shape),
    )


def _kinds(pairing: Pairing, shard: Ints, accuracy: Floats) -> Ints:
    """Return (e,) equal numbers for overlaps that count alike if they are matched."""
    edges = pairing.edges
    unlabelled = pairing.predictions.unlabelled[edges.prediction].astype(np.int64)
    return key_numbers(
        accuracy.view(np.int32), unlabelled, pairing.truth.level[edges.truth], shard[edges.truth]
    )


def _false_shards(pairing: Pairing, shard: Ints, parts: int) -> list[Ints]:
    """Return the shards in which each prediction is false if it has no match, as `parts` arrays of (m,).

    A prediction that touches labels belongs to the shard of the label it touches most, the last one of
    equals; any other one belongs to all shards of its type.
    """
    near = pairing.edges[pairing.edges.iou >= np.float64(NEAR_IOU)]
    near = near[np.lexsort((near.truth, near.iou, near.prediction))]
    nearest = np.full(len(pairing.predictions), -1)
    nearest[near.prediction] = near.truth
    of_nearest = np.append(shard, -1)[nearest]
    false_shards = []
    for part in range(parts):
        mine = np.where(pairing.predictions.type > 0, parts * (pairing.predictions.type - 1) + part, -1)
        false_shards.append(np.where((nearest < 0) | (of_nearest == mine), mine, -1))
    return false_shards


def _sum_ha(
    pairing: Pairing, matches: Matches, hit: Ints, accuracy: Floats, shape: tuple[int, int]
) -> Floats:
    """Return (s, c) float32 sums of heading accuracies, in the official order.

    Float32 sums depend on it: within a frame by prediction, then over the frames.
    """
    prediction = pairing.edges.prediction[matches.edge]
    order = np.argsort(prediction, kind="stable")
    order = order[hit[order] >= 0]
    frame = pairing.prediction_frame[prediction]
    columns = (frame, hit, matches.since, matches.until, accuracy)
    total, of_frame = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    last = -1
    for at, row, since, until, value in zip(*(c[order].tolist() for c in columns), strict=True):
        if at != last:
            total += of_frame
            of_frame[:] = 0
            last = at
        of_frame[row, since:until] += np.float32(value)
    return total + of_frame


def _result(name: str, level: int, shard: int, counts: _Counts) -> DetectionResult:
    tp, fp, fn, sum_ha = counts.tp[shard], counts.fp[shard], counts.fn[level][shard], counts.sum_ha[shard]
    recall = _ratio(tp, tp + fn)
    precision = np.where(recall == 0, np.float32(1), _ratio(tp, tp + fp))
    precision_ha = np.where(recall == 0, np.float32(1), _ratio(sum_ha, tp + fp))
    ap, aph = average_precision(precision, recall), average_precision(precision_ha, recall)
    return DetectionResult(name, level, ap, aph, tp, fp, fn, sum_ha, precision, precision_ha, recall)


def _ratio(part: Array, total: Ints) -> Floats:
    """Return the float32 quotient, 0 where there is nothing to divide by."""
    some = np.maximum(total, 1).astype(np.float32)
    return np.where(total > 0, part.astype(np.float32) / some, np.float32(0))
