"""From boxes in frames to tracks: which are linked, and what becomes of the links at each cut-off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.metrics.assignment import weights_of
from upvl_cli.metrics.matching import Matches, components
from upvl_cli.metrics.mot import Event, Link, follow
from upvl_cli.metrics.official import Matcher
from upvl_cli.metrics.pairing import Edges, Pairing
from upvl_cli.metrics.tally import numbered
from upvl_cli.types import Array, Bools, Ints


@dataclass(frozen=True)
class Split:
    """A pairing, and the shard of each of its boxes.

    Attributes:
        pairing: Boxes and overlaps.
        truth_shard: (n,) shard of each label, -1 for none.
        prediction_shard: (m,) shard of each prediction, -1 for none.
    """

    pairing: Pairing
    truth_shard: Ints
    prediction_shard: Ints


@dataclass(frozen=True)
class History:
    """What happened over all frames.

    Attributes:
        since: (m,) first cut-off that uses each prediction.
        until: (m,) cut-off that ends its use.
        matches: Who was matched with whom.
        slips: (k, 3) mismatches: shard, first cut-off, cut-off that ends it.
    """

    since: Ints
    until: Ints
    matches: Matches
    slips: Ints


def history(split: Split, reached: Bools, until: Ints, cutoffs: int, matcher: Matcher) -> History:
    """Return matches and mismatches of all segments and shards.

    Args:
        split: Boxes and shards.
        reached: (e,) whether an overlap reaches the threshold.
        until: (m,) number of the first cut-off that drops each prediction.
        cutoffs: Number of cut-offs.
        matcher: Official rule for pairs that were not matched before.

    Raises:
        BadInput: A label stands twice in a frame.
    """
    pairing, edges = split.pairing, split.pairing.edges
    truth_track = _tracks(pairing, pairing.truth_frame, split.truth_shard, pairing.truth.object_id)
    prediction_track = _tracks(
        pairing, pairing.prediction_frame, split.prediction_shard, pairing.predictions.object_id
    )
    _refuse_twins(split, truth_track)
    since = _first_used(pairing.prediction_frame, prediction_track, until)
    shard = split.prediction_shard[edges.prediction]
    usable = reached & (shard == split.truth_shard[edges.truth]) & (shard >= 0)
    chosen = np.flatnonzero(usable & (since < until)[edges.prediction])
    linked = Edges(
        prediction_track[edges.prediction[chosen]], truth_track[edges.truth[chosen]], edges.iou[chosen]
    )
    knot = components(linked, len(prediction_track), len(truth_track))
    plain = _one_to_one(linked, knot)
    alone = edges.prediction[chosen[plain]]
    simple = np.column_stack([chosen[plain], since[alone], until[alone]])
    present = _present(pairing.truth_frame, truth_track, linked.truth[~plain])
    frames = _links(pairing, chosen[~plain], linked[~plain], knot[~plain], since, until)
    events = [event for knot_frames in frames for event in follow(knot_frames, present, cutoffs, matcher)]
    matches = np.concatenate([simple, _rows(events)])
    return History(since, until, Matches(*matches.T), _slips(split, events))


def _tracks(pairing: Pairing, frame: Ints, shard: Ints, object_id: Array) -> Ints:
    """Return numbers that are equal for boxes of one segment, shard and id."""
    return numbered(pairing.sequence[frame], shard, np.unique(object_id, return_inverse=True)[1])


def _refuse_twins(split: Split, truth_track: Ints) -> None:
    pairing = split.pairing
    inside = np.flatnonzero(split.truth_shard >= 0)
    key = numbered(pairing.truth_frame[inside], truth_track[inside])
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    if (count > 1).any():
        label = pairing.truth[inside[first[count > 1]]]
        raise BadInput(
            f"segment {label.sequence[0]}, frame {label.frame[0]}: two labels have the id "
            f"'{label.object_id[0]}'; tracking needs each id once a frame"
        )


def _first_used(frame: Ints, track: Ints, until: Ints) -> Ints:
    """Return (m,) the first cut-off that uses each prediction: of two with one id, the first one."""
    since = np.zeros_like(until)
    key = numbered(frame, track)
    order = np.argsort(key, kind="stable")
    twins = np.flatnonzero(np.diff(key[order]) == 0)
    for before, this in zip(order[twins], order[twins + 1], strict=True):
        since[this] = max(since[before], until[before])
    return np.minimum(since, until)


def _one_to_one(linked: Edges, knot: Ints) -> Bools:
    """Return (e,) whether a knot is one track of labels and one of predictions: nothing can be mistaken."""
    pair = numbered(linked.prediction, linked.truth)
    _, first = np.unique(pair, return_index=True)
    pairs_of_knot = np.bincount(knot[first], minlength=knot.max(initial=-1) + 1)
    return np.asarray(pairs_of_knot[knot] == 1)


def _present(frame: Ints, track: Ints, wanted: Ints) -> set[tuple[int, int]]:
    """Return (track, frame) of all labels of the wanted tracks."""
    mine = np.isin(track, wanted)
    return set(zip(track[mine].tolist(), frame[mine].tolist(), strict=True))


def _links(
    pairing: Pairing, chosen: Ints, linked: Edges, knot: Ints, since: Ints, until: Ints
) -> Iterator[list[list[Link]]]:
    """Yield the links of each knot, by frame in order of time."""
    edges = pairing.edges[chosen]
    columns = (
        pairing.prediction_frame[edges.prediction],
        linked.truth,
        linked.prediction,
        since[edges.prediction],
        until[edges.prediction],
        weights_of(edges.iou),
        pairing.predictions.score[edges.prediction],
        chosen,
    )
    order = np.argsort(knot, kind="stable")
    links = map(Link, *(column[order].tolist() for column in columns))
    for _, mine in groupby(zip(knot[order].tolist(), links, strict=True), key=lambda pair: pair[0]):
        by_frame = groupby((link for _, link in mine), key=lambda link: link.frame)
        yield [list(group) for _, group in by_frame]


def _rows(events: list[Event]) -> Ints:
    rows = [(edge, event.since, event.until) for event in events for edge in event.matched]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def _slips(split: Split, events: list[Event]) -> Ints:
    shard, truth = split.truth_shard, split.pairing.edges.truth
    slipped = [event for event in events for _ in range(event.mismatches)]
    rows = [(shard[truth[event.matched[0]]], event.since, event.until) for event in slipped]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)
