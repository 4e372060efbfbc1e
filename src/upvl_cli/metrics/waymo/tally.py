"""Counts at every score cut-off of what holds from one cut-off to another, added up by shard."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.matching import Matches
from upvl_cli.metrics.waymo.pairing import Edges
from upvl_cli.types import Array, Floats, Ints


def count_spans(shard: Ints, since: Ints, until: Ints, shape: tuple[int, int]) -> Ints:
    """Return (s, c) how many of these things hold in each shard at each cut-off.

    Args:
        shard: (k,) shard of each thing, -1 for none.
        since: (k,) first cut-off at which it holds.
        until: (k,) first cut-off at which it does not hold any more.
        shape: Number of shards and of cut-offs.
    """
    return sum_spans(shard, since, until, np.ones(len(shard)), shape).astype(np.int64)


def sum_spans(shard: Ints, since: Ints, until: Ints, weight: Floats, shape: tuple[int, int]) -> Floats:
    """Return (s, c) sums of the weights of the things that hold; see `count_spans`.

    Args:
        shard: (k,) shard of each thing, -1 for none.
        since: (k,) first cut-off at which it holds.
        until: (k,) first cut-off at which it does not hold any more.
        weight: (k,) what each adds.
        shape: Number of shards and of cut-offs.
    """
    shards, columns = shape[0], shape[1] + 1
    inside = np.flatnonzero(shard >= 0)
    row, weight = shard[inside] * columns, weight[inside]
    places = np.concatenate([row + since[inside], row + until[inside]])
    steps = np.bincount(places, np.concatenate([weight, -weight]), minlength=shards * columns)
    return np.asarray(steps.reshape(shards, columns)[:, :-1].cumsum(axis=1))


def count_missed(
    truth: Truth, shard: Ints, edges: Edges, matches: Matches, level: int, shape: tuple[int, int]
) -> Ints:
    """Return (s, c) how many labels up to a level have no match.

    Args:
        truth: Labels.
        shard: (n,) shard of each label, -1 for none.
        edges: (k,) the matched overlaps.
        matches: (k,) where they hold.
        level: Labels of a higher level do not count.
        shape: Number of shards and of cut-offs.
    """
    shard = np.where(truth.level <= level, shard, -1)
    labels = np.bincount(shard[shard >= 0], minlength=shape[0])
    return np.asarray(labels[:, None] - count_spans(shard[edges.truth], matches.since, matches.until, shape))


def cutoffs_kept(predictions: Predictions, score_cutoffs: Array) -> Ints:
    """Return (m,) number of the first cut-off that drops each prediction: of how many cut-offs keep it.

    Args:
        predictions: Boxes with scores.
        score_cutoffs: (c,) ascending cut-offs, compared as float32; a score equal to one is kept.

    Raises:
        BadInput: The cut-offs do not ascend, or there is none.
    """
    cutoffs = np.asarray(score_cutoffs, dtype=np.float32)
    if not len(cutoffs) or not (np.diff(cutoffs) >= 0).all():
        raise BadInput("score cut-offs must be ascending numbers, and at least one")
    return np.searchsorted(cutoffs, predictions.score, side="right")


def check_thresholds(iou_thresholds: Sequence[float]) -> Array:
    """Return the (5,) IoU thresholds by type.

    Args:
        iou_thresholds: Minimum IoU by type; the one of type 0 is not used.

    Raises:
        BadInput: There are not five of them, or one is outside of 0.000001 to 1.
    """
    thresholds = np.asarray(iou_thresholds, dtype=np.float32)
    # Below a millionth a pair can match without weight: then the official matching is arbitrary.
    if thresholds.shape != (5,) or not ((thresholds[1:] >= np.float32(1e-6)) & (thresholds[1:] <= 1)).all():
        raise BadInput(f"IoU thresholds {iou_thresholds}: expected five (by type), from 0.000001 to 1")
    return thresholds


def key_numbers(*keys: Ints) -> Ints:
    """Return (k,) numbers that are equal where all keys are equal.

    Args:
        keys: (k,) integers from -1 upwards.
    """
    number = np.zeros(len(keys[0]), dtype=np.int64)
    for key in keys:
        combined = number * (key.max(initial=0) + 2) + key + 1
        number = np.unique(combined, return_inverse=True)[1].reshape(-1)
    return number
