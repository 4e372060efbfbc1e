"""The official rules once more, slow and plain: every frame, shard and cut-off on its own, padded tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment

from upvl_cli.geometry.iou import iou_3d
from upvl_cli.metrics.waymo.assignment import official_hungarian
from upvl_cli.metrics.waymo.breakdown import Breakdown
from upvl_cli.metrics.waymo.heading import heading_accuracy
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.types import Array

Solve = Callable[[Array, Array, Array], Array]


def scipy_hungarian(weight: Array, *_: Array) -> Array:
    """Column of each row of the padded square table."""
    n = max(weight.shape)
    padded = np.zeros((n, n), dtype=np.int64)
    padded[: weight.shape[0], : weight.shape[1]] = weight
    columns = linear_sum_assignment(padded, maximize=True)[1][: len(weight)]
    return np.array([c if padded[r, c] > 0 else -1 for r, c in enumerate(columns)], dtype=np.int64)


def ties_as_official(weight: Array, *_: Array) -> Array:
    """The same with the official choice among equal matchings."""
    return official_hungarian(weight)


def score_first(weight: Array, of_frame: Array, score: Array) -> Array:
    """Each prediction in turn takes the free label whose weight is highest in the wrong rows and columns."""
    column = np.full(len(weight), -1)
    for p in sorted(range(len(weight)), key=lambda i: -score[i]):
        best = -1
        for t in range(weight.shape[1]):
            if weight[p, t] > 0 and t not in column and of_frame[p, t] > best:
                best, column_now = of_frame[p, t], t
        if best >= 0:
            column[p] = column_now
    return column


def frames(truth: Truth, predictions: Predictions) -> Iterator[tuple[str, int, Truth, Predictions]]:
    """Segment, frame and boxes of every frame that either side has."""
    moments = set(zip(truth.sequence.tolist(), truth.frame.tolist(), strict=True))
    moments |= set(zip(predictions.sequence.tolist(), predictions.frame.tolist(), strict=True))
    for sequence, frame in sorted(moments):
        here = [(b.sequence == sequence) & (b.frame == frame) for b in (truth, predictions)]
        yield sequence, frame, truth[here[0]], predictions[here[1]]


def tables(truth: Truth, predictions: Predictions, thresholds: Array) -> tuple[Array, Array, Array]:
    """(p, t) float32 IoU of equal types, its weight, and the weight of pairs that reach the threshold."""
    iou = iou_3d(predictions, truth).astype(np.float32)
    iou[predictions.type[:, None] != truth.type] = 0
    least = np.asarray(thresholds, dtype=np.float32)[predictions.type][:, None]
    weight = np.floor((iou * np.float32(1e6)).astype(np.float64) + 0.5).astype(np.int64)
    return iou, weight, np.where((iou >= least) & (predictions.type[:, None] > 0), weight, 0)


def plain_detection(
    truth: Truth,
    predictions: Predictions,
    thresholds: Array,
    breakdown: Breakdown,
    cutoffs: Array,
    solve: Solve = scipy_hungarian,
) -> dict[str, Array]:
    """(level, shard, cut-off) counts tp, fp, fn and the sum of heading accuracies."""
    shape = (2, len(breakdown.shards), len(cutoffs))
    counts = {name: np.zeros(shape) for name in ("tp", "fp", "fn", "ha")}
    for _, _, labels, boxes in frames(truth, predictions):
        iou, of_frame, weight = tables(labels, boxes, thresholds)
        shard = breakdown.shard_of(labels)
        parts = len(breakdown.shards) // 4
        of_box = boxes.type - 1 if breakdown.types_apart else breakdown.shard_of(boxes)
        for s in range(len(breakdown.shards)):
            group = s // parts if breakdown.types_apart else s
            mine = np.flatnonzero((labels.type - 1 if breakdown.types_apart else shard) == group)
            for c, cutoff in enumerate(cutoffs):
                used = np.flatnonzero((of_box == group) & (boxes.score >= cutoff))
                near = weight[np.ix_(used, mine)]
                column = solve(near, of_frame, boxes.score[used]) if near.size else [-1] * len(used)
                _count(counts, s, c, labels, boxes, iou, shard, used, mine, column, breakdown.types_apart)
    return counts


def _count(counts, s, c, labels, boxes, iou, shard, used, mine, column, apart):  # type: ignore[no-untyped-def]
    for p, j in zip(used, column, strict=True):
        if j >= 0 and shard[mine[j]] == s:
            counts["tp"][:, s, c] += 1
            counts["ha"][:, s, c] += heading_accuracy(boxes.heading_rad[[p]], labels.heading_rad[[mine[j]]])[
                0
            ]
        if j < 0 and not boxes.unlabelled[p]:
            near = [t for t in mine if iou[p, t] >= 0.01]
            best = max(near, key=lambda t: (iou[p, t], t), default=None)
            counts["fp"][:, s, c] += not apart or best is None or shard[best] == s
    for j, t in enumerate(mine):
        if j not in column and shard[t] == s:
            counts["fn"][:, s, c] += labels.level[t] <= np.array([1, 2])


def plain_tracking(
    truth: Truth,
    predictions: Predictions,
    thresholds: Array,
    breakdown: Breakdown,
    cutoffs: Array,
) -> dict[str, Array]:
    """(level, shard, cut-off) counts miss, false_positive, mismatch, match, truth and cost."""
    names = ("miss", "false_positive", "mismatch", "match", "truth", "cost")
    counts = {name: np.zeros((2, len(breakdown.shards), len(cutoffs))) for name in names}
    everything = [(*f, *tables(f[2], f[3], thresholds)) for f in frames(truth, predictions)]
    for s in range(len(breakdown.shards)):
        for c, cutoff in enumerate(cutoffs):
            owner: dict[tuple[str, str], str] = {}
            for sequence, _, labels, boxes, iou, _, weight in everything:
                mine = {labels.object_id[t]: t for t in np.flatnonzero(breakdown.shard_of(labels) == s)}
                used: dict[str, int] = {}
                for p in np.flatnonzero((breakdown.shard_of(boxes) == s) & (boxes.score >= cutoff)):
                    used.setdefault(boxes.object_id[p], p)
                old = {g: p for (q, g), p in owner.items() if q == sequence}
                new = _mapped(old, mine, used, weight)
                _count_tracks(counts, (slice(None), s, c), old, new, mine, used, labels, boxes, iou)
                taken = set(new.values())
                old = {g: p for g, p in old.items() if p not in taken} | new
                owner = {key: p for key, p in owner.items() if key[0] != sequence}
                owner |= {(sequence, g): p for g, p in old.items()}
    return counts


def _mapped(old, mine, used, weight):  # type: ignore[no-untyped-def]
    new = {g: p for g, p in old.items() if g in mine and p in used and weight[used[p], mine[g]] > 0}
    rows = [p for p in used if p not in new.values()]
    columns = [g for g in mine if g not in new]
    if rows and columns:
        column = scipy_hungarian(weight[np.ix_([used[p] for p in rows], [mine[g] for g in columns])])
        new |= {columns[j]: p for p, j in zip(rows, column, strict=True) if j >= 0}
    return new


def _count_tracks(counts, at, old, new, mine, used, labels, boxes, iou):  # type: ignore[no-untyped-def]
    before = {p: g for g, p in old.items()}
    for g, p in new.items():
        counts["mismatch"][at] += g in old and old[g] != p
        counts["mismatch"][at] += p in before and before[p] not in mine
        counts["cost"][at] += 1 - float(iou[used[p], mine[g]])
    counts["match"][at] += len(new)
    matched = set(new.values())
    counts["false_positive"][at] += sum(p not in matched and not boxes.unlabelled[i] for p, i in used.items())
    missed = np.array([labels.level[t] for g, t in mine.items() if g not in new])
    for level in (1, 2):
        counts["miss"][level - 1, at[1], at[2]] += (missed <= level).sum()
        counts["truth"][level - 1, at[1], at[2]] += (missed <= level).sum() + len(new)
