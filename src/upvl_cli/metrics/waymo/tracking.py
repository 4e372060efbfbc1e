"""Multi-object tracking scores as the Waymo Open Dataset's tracking tool computes them.

Source: waymo-open-dataset 99a4cb3, metrics/tracking_metrics.cc and mot.cc. Levels are used as they are
stored and labels without points stay, other than in detection. Of all cut-offs, each shard and level takes
the one of its highest MOTA.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from upvl_cli.metrics.waymo.breakdown import Breakdown
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.official import LEVELS, Matcher
from upvl_cli.metrics.waymo.pairing import can_match, pair_frames
from upvl_cli.metrics.waymo.speeds import estimate_speeds
from upvl_cli.metrics.waymo.tally import check_thresholds, count_missed, count_spans, cutoffs_kept, sum_spans
from upvl_cli.metrics.waymo.tracks import History, Split, history
from upvl_cli.types import Array, Floats, Ints


@dataclass(frozen=True)
class TrackingCounts:
    """Counts at each cut-off.

    Attributes:
        miss: (c,) labels without a match.
        false_positive: (c,) predictions without a match.
        mismatch: (c,) changes of identity.
        match: (c,) matched predictions.
        truth: (c,) labels that count; matched ones of a higher level are among them.
        cost: (c,) sum of 1 - IoU over the matches.
    """

    miss: Ints
    false_positive: Ints
    mismatch: Ints
    match: Ints
    truth: Ints
    cost: Floats


@dataclass(frozen=True)
class TrackingResult:
    """Scores of one shard at one level, at the lowest cut-off of its highest MOTA.

    Attributes:
        name: Shard and level as the official tool names them.
        level: 1 or 2.
        mota: Accuracy; 0 where no cut-off has a positive one, and then all ratios are 0.
        motp: Mean of 1 - IoU over the matches: lower is better.
        miss: Labels missed, as a share of all labels.
        false_positive: False predictions, as the same share.
        mismatch: Changes of identity, as the same share.
        score_cutoff: Where these hold; None where no cut-off has a positive MOTA.
        labels: Number of labels as the tool reports it: at the last cut-off that counts any.
        counts: What the ratios come from, at every cut-off.
    """

    name: str
    level: int
    mota: float
    motp: float
    miss: float
    false_positive: float
    mismatch: float
    score_cutoff: float | None
    labels: int
    counts: TrackingCounts


def tracking(
    truth: Truth,
    predictions: Predictions,
    *,
    iou_thresholds: Sequence[float],
    breakdowns: Sequence[Breakdown],
    score_cutoffs: Array,
    matcher: Matcher,
) -> list[TrackingResult]:
    """Return the scores in the official order: breakdown, shard, level.

    Args:
        truth: Labels; level as stored.
        predictions: Tracked boxes; of two with the same id in one frame and shard, the first one counts.
        iou_thresholds: Minimum IoU of a match by type, type 0 first.
        breakdowns: Ways to split the boxes; by speed, a prediction's own one counts.
        score_cutoffs: (c,) ascending.
        matcher: Official rule of matching; the tools use "hungarian".

    Raises:
        BadInput: A box or a setting is unusable, or a label stands twice in a frame.
    """
    pairing = pair_frames(truth, predictions)
    if any(breakdown.by_speed for breakdown in breakdowns):
        pairing = replace(pairing, predictions=estimate_speeds(pairing))
    reached = can_match(pairing, check_thresholds(iou_thresholds))
    until = cutoffs_kept(pairing.predictions, score_cutoffs)
    results = []
    for breakdown in breakdowns:
        split = Split(pairing, breakdown.shard_of(pairing.truth), breakdown.shard_of(pairing.predictions))
        events = history(split, reached, until, len(score_cutoffs), matcher)
        shape = len(breakdown.shards), len(score_cutoffs)
        counts = {level: _count(split, events, level, shape) for level in LEVELS}
        for shard, name in enumerate(breakdown.shards):
            for level in LEVELS:
                of_shard = _of_shard(counts[level], shard)
                results.append(_best(f"{name}_LEVEL_{level}", level, score_cutoffs, of_shard))
    return results


def _count(split: Split, events: History, level: int, shape: tuple[int, int]) -> TrackingCounts:
    """Return (s, c) counts of all shards."""
    pairing, matches = split.pairing, events.matches
    edges, kept = pairing.edges[matches.edge], (matches.since, matches.until)
    matched_shard = split.truth_shard[edges.truth]
    match = count_spans(matched_shard, *kept, shape)
    cost = sum_spans(matched_shard, *kept, 1 - edges.iou.astype(np.float64), shape)
    counted = np.where(pairing.predictions.unlabelled, -1, split.prediction_shard)
    used = count_spans(counted, events.since, events.until, shape)
    miss = count_missed(pairing.truth, split.truth_shard, edges, matches, level, shape)
    shard, since, until = events.mismatches.T
    return TrackingCounts(
        miss=miss,
        false_positive=used - count_spans(counted[edges.prediction], *kept, shape),
        mismatch=count_spans(shard, since, until, shape),
        match=match,
        truth=miss + match,
        cost=np.where(match > 0, np.maximum(cost, 0), 0),  # where nothing matches, no rest of rounding
    )


def _of_shard(counts: TrackingCounts, shard: int) -> TrackingCounts:
    return TrackingCounts(*(getattr(counts, spec.name)[shard] for spec in fields(counts)))


def _best(name: str, level: int, score_cutoffs: Array, counts: TrackingCounts) -> TrackingResult:
    """Return the result at the cut-off of the highest MOTA, in the float32 steps of the official tool."""
    labels_or_1 = np.maximum(counts.truth, 1).astype(np.float32)
    miss, false, mismatch = (
        part.astype(np.float32) / labels_or_1
        for part in (counts.miss, counts.false_positive, counts.mismatch)
    )
    mota = (1 - (miss + false + mismatch).astype(np.float64)).astype(np.float32)
    mota[counts.truth == 0] = 0
    labels = int(counts.truth[np.flatnonzero(counts.truth)[-1:]].sum())
    at = int(mota.argmax())
    if mota[at] <= 0:
        return TrackingResult(name, level, 0.0, 0.0, 0.0, 0.0, 0.0, None, labels, counts)
    motp = np.float32(counts.cost[at] / max(int(counts.match[at]), 1))
    cutoff = np.float32(score_cutoffs[at])
    mota_motp = float(mota[at]), float(motp)
    shares = float(miss[at]), float(false[at]), float(mismatch[at])
    return TrackingResult(name, level, *mota_motp, *shares, float(cutoff), labels, counts)
