"""Matching of predictions with labels at every score cut-off at once.

A cut-off only removes predictions, and pairs that share neither box do not touch each other. So a frame
falls apart into small groups, most of them a single pair, and each group has a handful of states. Only
where two matchings of a group weigh the same and count differently does the official order of ties decide;
there the whole frame is solved as the official tool does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from upvl_cli.metrics.waymo.assignment import (
    heaviest_matching,
    official_hungarian,
    official_score_first,
    weights_of,
)
from upvl_cli.metrics.waymo.official import Matcher
from upvl_cli.metrics.waymo.pairing import Edges, Pairing
from upvl_cli.types import Array, Bools, Ints, ParallelArrays, array

Row = tuple[int, int, int]  # edge, since, until


@dataclass(frozen=True)
class Matches(ParallelArrays):
    """Pairs that are matched at cut-offs number `since` to `until` - 1.

    Attributes:
        edge: (k,) number of the overlap.
        since: (k,) first cut-off.
        until: (k,) first cut-off at which they are not matched any more.
    """

    edge: Array = array("int64")
    since: Array = array("int64")
    until: Array = array("int64")


def components(edges: Edges, predictions: int, labels: int) -> Ints:
    """Return (e,) a number that overlaps share where a chain of common boxes links them.

    Args:
        edges: The overlaps that count.
        predictions: How many predictions there are.
        labels: How many labels there are.
    """
    links = (np.ones(len(edges)), (edges.prediction, predictions + edges.truth))
    size = predictions + labels
    _, number = connected_components(coo_array(links, shape=(size, size)), directed=False)
    return np.asarray(number[edges.prediction], dtype=np.int64)


@dataclass(frozen=True)
class MatchingProblem:
    """Boxes that can be matched: those of one frame and group whose IoU reaches the threshold.

    Attributes:
        pairing: All boxes and overlaps.
        reached: (e,) whether an overlap reaches the threshold.
        truth_group: (n,) group of each label, -1 for none.
        prediction_group: (m,) group of each prediction.
        until: (m,) number of the first cut-off that drops each prediction.
        kind: (e,) equal for overlaps that count alike if they are matched, so that ties between them do not matter.
        matcher: Which official rule decides.
    """

    pairing: Pairing
    reached: Bools
    truth_group: Ints
    prediction_group: Ints
    until: Ints
    kind: Ints
    matcher: Matcher
    _solved: dict[tuple[int, int, int], dict[int, int]] = field(default_factory=dict)

    def matches(self) -> Matches:
        """Return the matched pairs, each with its cut-offs."""
        chosen = np.flatnonzero(self._can_match())
        edges = self.pairing.edges[chosen]
        number = components(edges, len(self.prediction_group), len(self.truth_group))
        alone = np.bincount(number)[number] == 1
        until = self.until[edges.prediction[alone]]
        simple = np.column_stack([chosen[alone], np.zeros_like(until), until])
        competing = np.flatnonzero(~alone)
        competing = competing[np.argsort(number[competing], kind="stable")]
        ends = np.flatnonzero(np.diff(number[competing])) + 1
        rows = [row for group in np.split(chosen[competing], ends) for row in self._matches_of(group)]
        return Matches(*np.concatenate([simple, np.array(rows, dtype=np.int64).reshape(-1, 3)]).T)

    def _can_match(self) -> Bools:
        """Return (e,) whether each overlap can become a match at any cut-off."""
        edges = self.pairing.edges
        group = self.prediction_group[edges.prediction]
        together = (group >= 0) & (group == self.truth_group[edges.truth])
        return np.asarray(self.reached & together & (self.until[edges.prediction] > 0))

    def _matches_of(self, group: Ints) -> Iterator[Row]:
        """Yield the matches among overlaps that compete."""
        edges = self.pairing.edges[group]
        until = self.until[edges.prediction].tolist()
        weight = weights_of(edges.iou).tolist()
        pairs = list(zip(edges.prediction.tolist(), edges.truth.tolist(), weight, strict=True))
        for since, end in pairwise(sorted({0, *until})):
            here = [i for i, u in enumerate(until) if u >= end]
            best, tied = heaviest_matching([pairs[i] for i in here])
            if self._order_matters([(weight[here[i]], self.kind[group[here[i]]]) for i in tied], len(here)):
                yield from self._official_matches(group[here], since, end)
            else:
                yield from ((int(group[here[i]]), since, end) for i in best)

    def _order_matters(self, tied: list[tuple[int, int]], competing: int) -> bool:
        """Return whether the counts depend on the order in which the official tool takes the boxes."""
        return competing > 1 if self.matcher == "score_first" else len(set(tied)) > 1

    def _official_matches(self, group: Ints, since: int, end: int) -> Iterator[Row]:
        """Yield the matches among these overlaps at these cut-offs, their whole frame solved in the official order."""
        edges = self.pairing.edges[group]
        frame = int(self.pairing.prediction_frame[edges.prediction[0]])
        number = int(self.prediction_group[edges.prediction[0]])
        p = self.pairing.predictions_of(frame)
        until = self.until[p][self.prediction_group[p] == number]
        for first, last in pairwise([since, *sorted({int(u) for u in until if since < u < end}), end]):
            label_of = self._solution(frame, number, first)
            for e, p, t in zip(group.tolist(), edges.prediction.tolist(), edges.truth.tolist(), strict=True):
                if label_of.get(p) == t:
                    yield e, first, last

    def _solution(self, frame: int, group: int, cutoff: int) -> dict[int, int]:
        """Return the label of each matched prediction of a group in one frame at one cut-off."""
        key = frame, group, cutoff
        if key not in self._solved:
            p, t = self.pairing.predictions_of(frame), self.pairing.labels_of(frame)
            rows = np.flatnonzero((self.prediction_group[p] == group) & (self.until[p] > cutoff))
            columns = np.flatnonzero(self.truth_group[t] == group)
            label_of = self._solve_frame(frame, rows, columns)
            used = np.flatnonzero(label_of >= 0)
            pairs = zip(rows[used].tolist(), columns[label_of[used]].tolist(), strict=True)
            self._solved[key] = {p.start + i: t.start + j for i, j in pairs}
        return self._solved[key]

    def _solve_frame(self, frame: int, rows: Ints, columns: Ints) -> Ints:
        """Return which of the columns each of the rows is matched with, -1 for none."""
        weight = self._weights(frame, self.reached)[np.ix_(rows, columns)]
        if self.matcher == "hungarian":
            return official_hungarian(weight)
        # The official matcher looks weights up under numbers of the group in the table of the whole frame.
        misread = self._weights(frame, np.ones_like(self.reached))[: len(rows), : len(columns)]
        score = self.pairing.predictions.score[self.pairing.predictions_of(frame)][rows]
        return official_score_first(weight > 0, misread, score)

    def _weights(self, frame: int, counted: Bools) -> Ints:
        """Return weights of all predictions and labels of a frame, 0 where they do not overlap or count."""
        p, t, e = (
            part(frame)
            for part in (self.pairing.predictions_of, self.pairing.labels_of, self.pairing.edges_of)
        )
        edges = self.pairing.edges[e][counted[e]]
        weight = np.zeros((p.stop - p.start, t.stop - t.start), dtype=np.int64)
        weight[edges.prediction - p.start, edges.truth - t.start] = weights_of(edges.iou)
        return weight
