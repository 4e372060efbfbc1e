"""The answer to a question: the best box of each track, with scores, before a threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from upvl_cli.query.find import Hits
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.types import Floats, Ints, concat

BINS = 20


@dataclass(frozen=True)
class Answer:
    """What was found.

    Attributes:
        hits: The best box of each track, best first.
        vocabulary: The words that they were compared with; one class without words where nothing was compared.
        kind: What a score is: "votes", "confidence" or "similarity".
        counts: How many boxes there were, and of each fate.
        notes: Sentences about the whole answer.
        remarks: What a relation says of each hit; empty where there is none.
        threshold: Minimum score where none is chosen.
    """

    hits: Hits
    vocabulary: Vocabulary
    kind: str
    counts: Mapping[str, int]
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    threshold: float = 0.0
    histogram: Ints = field(init=False)

    def __post_init__(self) -> None:
        bins = np.clip((self.hits.score * BINS).astype(np.int64), 0, BINS - 1)
        object.__setattr__(self, "histogram", np.bincount(bins, minlength=BINS))

    def above(self, threshold: float) -> int:
        """Return how many hits reach a threshold; they stand first."""
        return int(np.searchsorted(-self.hits.score, -np.float32(threshold), side="right"))


def plain_vocabulary() -> Vocabulary:
    """Return a vocabulary of one class that no word describes."""
    return Vocabulary(("object",), ("",), np.zeros(1, np.int64), np.zeros((1, 0), np.float32))


def best_boxes_of_tracks(track_id: Ints, score: Floats) -> Ints:
    """Return the row of the best box of each track of a drive; a box without a track is one of its own.

    Args:
        track_id: (n,) number of the track of each box, -1 for none.
        score: (n,) higher is better; of equals the first wins.
    """
    key = np.where(track_id < 0, -1 - np.arange(len(track_id)), track_id)
    order = np.lexsort((-score, key))
    return np.asarray(order[np.unique(key[order], return_index=True)[1]])


def by_score(parts: Sequence[Hits]) -> Hits:
    """Return all hits by descending score, then in their order."""
    hits = concat(parts, Hits)
    return hits[np.argsort(-hits.score, kind="stable")]
