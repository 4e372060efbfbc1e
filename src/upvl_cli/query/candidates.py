"""Boxes that are to be classified, and the classes of a few of them at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.labels.look_votes import look_shares
from upvl_cli.pipeline.tables import Table
from upvl_cli.query.index import Objects
from upvl_cli.query.store import Store
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.query.votes import LookShares, VoteResult, vote
from upvl_cli.runtime.parallel import in_order
from upvl_cli.stages.rows import PointFeatureRow
from upvl_cli.types import Ints, concat

OpenTable = Callable[[str], Table[PointFeatureRow]]


@dataclass(frozen=True)
class Candidates:
    """The boxes of one drive that are to be classified.

    Attributes:
        segment: Name of the drive.
        objects: All n boxes of the drive.
        rows: (k,) which of them, ascending.
    """

    segment: str
    objects: Objects
    rows: Ints


def shares_of_looks(store: Store, vocabulary: Vocabulary, objects: Objects) -> LookShares | None:
    """Return what looks at the tracks of some boxes name; None where there are none."""
    shown = objects.num_looks > 0
    if not shown.any():
        return None
    cosines = store.basis.cosines(objects.look_feature, vocabulary.vectors)
    share = look_shares(cosines, vocabulary.class_of_word, store.looks.temperature)
    return LookShares(share * shown[:, None], cosines, shown, store.looks.weight)


def vote_at_once(
    store: Store, vocabulary: Vocabulary, candidates: Sequence[Candidates], open_table: OpenTable
) -> list[VoteResult]:
    """Return the classes of the boxes of each drive; the features of all their points are held at once.

    Args:
        store: The stored boxes.
        vocabulary: The words.
        candidates: A few boxes of some drives.
        open_table: Gives the features of the points of a drive.
    """
    if not candidates:
        return []
    features = [
        part
        for drive in in_order(lambda c: _features(c, open_table(c.segment)), candidates)
        for part in drive
    ]
    objects = concat([chosen.objects[chosen.rows] for chosen in candidates], Objects)
    box_of_point = np.repeat(np.arange(len(features)), [len(codes) for codes in features])
    cosines = store.basis.cosines(np.concatenate(features), vocabulary.vectors)
    looks = shares_of_looks(store, vocabulary, objects)
    votes = vote(cosines, box_of_point, len(objects), vocabulary.class_of_word, looks)
    ends = np.cumsum([len(chosen.rows) for chosen in candidates])[:-1]
    columns = [
        np.split(getattr(votes, name), ends) for name in ("class_index", "word_index", "share", "cosine")
    ]
    return [VoteResult(*parts) for parts in zip(*columns, strict=True)]


def _features(chosen: Candidates, table: Table[PointFeatureRow]) -> list[Ints]:
    """Return the features of the points of each box of a drive."""
    frames, boxes = chosen.objects.frame[chosen.rows], chosen.objects.box[chosen.rows]
    found, previous, start = [], None, np.zeros(0, np.int64)
    for frame, box in zip(frames.tolist(), boxes.tolist(), strict=True):
        if frame != previous:
            features, previous = table[frame].point_feature, frame
            start = np.concatenate([[0], np.cumsum(features.count)])
        found.append(features.values[start[box] : start[box + 1]])
    return found
