"""Tracks of labels and predictions: which overlap, and their matches and mismatches at each cut-off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.assignment import weights_of
from upvl_cli.metrics.waymo.matching import Matches, components
from upvl_cli.metrics.waymo.mot import Event, Link, follow_tracks
from upvl_cli.metrics.waymo.official import Matcher
from upvl_cli.metrics.waymo.pairing import Edges, Pairing
from upvl_cli.metrics.waymo.tally import key_numbers
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
    """The matches and mismatches of all frames.

    Attributes:
        since: (m,) first cut-off that uses each prediction.
        until: (m,) cut-off that ends its use.
        matches: The matched pairs.
        mismatches: (k, 3) mismatches: shard, first cut-off, cut-off that ends it.
    """

    since: Ints
    until: Ints
    matches: Matches
    mismatches: Ints


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
    _check_unique_ids(split, truth_track)
    since = _first_used(pairing.prediction_frame, prediction_track, until)
    shard = split.prediction_shard[edges.prediction]
    usable = reached & (shard == split.truth_shard[edges.truth]) & (shard >= 0)
    chosen = np.flatnonzero(usable & (since < until)[edges.prediction])
    linked = Edges(
        prediction_track[edges.prediction[chosen]], truth_track[edges.truth[chosen]], edges.iou[chosen]
    )
    component = components(linked, len(prediction_track), len(truth_track))
    is_simple = _one_to_one(linked, component)
    alone = edges.prediction[chosen[is_simple]]
    simple = np.column_stack([chosen[is_simple], since[alone], until[alone]])
    present = _present(pairing.truth_frame, truth_track, linked.truth[~is_simple])
    frames = _links(pairing, chosen[~is_simple], linked[~is_simple], component[~is_simple], since, until)
    events = [
        event
        for component_frames in frames
        for event in follow_tracks(component_frames, present, cutoffs, matcher)
    ]
    matches = np.concatenate([simple, _rows(events)])
    return History(since, until, Matches(*matches.T), _mismatches(split, events))


def _tracks(pairing: Pairing, frame: Ints, shard: Ints, object_id: Array) -> Ints:
    """Return numbers that are equal for boxes of one segment, shard and id."""
    return key_numbers(pairing.sequence[frame], shard, np.unique(object_id, return_inverse=True)[1])


def _check_unique_ids(split: Split, truth_track: Ints) -> None:
    pairing = split.pairing
    inside = np.flatnonzero(split.truth_shard >= 0)
    key = key_numbers(pairing.truth_frame[inside], truth_track[inside])
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    if (count > 1).any():
        label = pairing.truth[inside[first[count > 1]]]
        raise BadInput(
            f"segment {label.sequence[0]}, frame {label.frame[0]}: two labels have the id "
            f"'{label.object_id[0]}'; tracking needs each id once a frame"
        )


def _first_used(frame: Ints, track: Ints, until: Ints) -> Ints:
    """Return (m,) the first cut-off that uses each prediction: of two with one id in a frame, the first one."""
    since = np.zeros_like(until)
    key = key_numbers(frame, track)
    order = np.argsort(key, kind="stable")
    repeated = np.flatnonzero(np.diff(key[order]) == 0)
    for before, this in zip(order[repeated], order[repeated + 1], strict=True):
        since[this] = max(since[before], until[before])
    return np.minimum(since, until)


def _one_to_one(linked: Edges, component: Ints) -> Bools:
    """Return (e,) whether a component is one track of labels and one of predictions: nothing can be mistaken."""
    pair = key_numbers(linked.prediction, linked.truth)
    _, first = np.unique(pair, return_index=True)
    pairs_of_component = np.bincount(component[first], minlength=component.max(initial=-1) + 1)
    return np.asarray(pairs_of_component[component] == 1)


def _present(frame: Ints, track: Ints, wanted: Ints) -> set[tuple[int, int]]:
    """Return (track, frame) of all labels of the wanted tracks."""
    chosen = np.isin(track, wanted)
    return set(zip(track[chosen].tolist(), frame[chosen].tolist(), strict=True))


def _links(
    pairing: Pairing, chosen: Ints, linked: Edges, component: Ints, since: Ints, until: Ints
) -> Iterator[list[list[Link]]]:
    """Yield the links of each component, by frame in order of time."""
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
    order = np.argsort(component, kind="stable")
    links = map(Link, *(column[order].tolist() for column in columns))
    for _, members in groupby(zip(component[order].tolist(), links, strict=True), key=lambda pair: pair[0]):
        by_frame = groupby((link for _, link in members), key=lambda link: link.frame)
        yield [list(group) for _, group in by_frame]


def _rows(events: list[Event]) -> Ints:
    rows = [(edge, event.since, event.until) for event in events for edge in event.matched]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def _mismatches(split: Split, events: list[Event]) -> Ints:
    shard, truth = split.truth_shard, split.pairing.edges.truth
    mismatched = [event for event in events for _ in range(event.mismatches)]
    rows = [(shard[truth[event.matched[0]]], event.since, event.until) for event in mismatched]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)
