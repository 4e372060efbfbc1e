"""The ranking of a search: by how much the best queried word of each box beats its best negative."""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.query.index import Objects
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.runtime.bounded_cache import BoundedCache
from upvl_cli.types import Array, Floats, Ints

_FEW = 1 / 8  # share of the boxes of a drive: of fewer, nothing is worth keeping for the next query
_ROWS = 4096  # at once: a megabyte in single precision, which stays in the cache of a core


class Ranking:
    """Ranks boxes; keeps the lengths of features and the cosines of negatives, which many queries share."""

    def __init__(self, basis: Basis, cache_bytes: int = 0) -> None:
        """Name the basis.

        Args:
            basis: Basis of the features.
            cache_bytes: Largest size of what is kept for the next query; 0 where there is none.
        """
        self._basis = basis
        self._cache: BoundedCache[Floats] = BoundedCache(cache_bytes, lambda values: values.nbytes)

    def score(
        self, segment: str, objects: Objects, rows: Ints, vocabulary: Vocabulary, *, uses_looks: bool
    ) -> Floats:
        """Return (k,) scores of some boxes of a drive: of the mean feature or of the looks, whichever is higher.

        Args:
            segment: Name of the drive.
            objects: All boxes of the drive.
            rows: (k,) which of them, ascending; each has points with features, or looks.
            vocabulary: The words.
            uses_looks: Whether looks count.
        """
        score = self._of_feature(segment, "pooled", objects.pooled, rows, vocabulary)
        shown = np.flatnonzero(uses_looks & (objects.num_looks[rows] > 0))
        if len(shown):
            of_looks = self._of_feature(segment, "looks", objects.look_feature, rows[shown], vocabulary)
            has_points = objects.num_features[rows[shown]] > 0
            score[shown] = np.where(has_points, np.maximum(score[shown], of_looks), of_looks)
        return score

    def _of_feature(self, segment: str, kind: str, codes: Ints, rows: Ints, vocabulary: Vocabulary) -> Floats:
        queried = int(vocabulary.is_queried.sum())
        negatives = vocabulary.words[queried:]
        if len(rows) < _FEW * len(codes):
            return self._of_few(codes[rows], vocabulary.vectors[:queried], vocabulary.vectors[queried:])
        everything = len(rows) == len(codes)
        key = (segment, kind, len(codes))
        length = self._cache.get_or_make((*key, "length"), lambda: self._lengths(codes))
        some = codes if everything else codes[rows]
        best = self._best(some, length if everything else length[rows], vocabulary.vectors[:queried])
        if not negatives:
            return best
        against = self._cache.get_or_make(
            (*key, negatives), lambda: self._best(codes, length, vocabulary.vectors[queried:])
        )
        return np.asarray(best - (against if everything else against[rows]))

    def _of_few(self, codes: Ints, words: Floats, negatives: Floats) -> Floats:
        length = self._lengths(codes)
        best = self._best(codes, length, words)
        return np.asarray(best - self._best(codes, length, negatives)) if len(negatives) else best

    def _lengths(self, codes: Ints) -> Floats:
        """Return (n,) lengths of the features in the full space (see `open_vocabulary`)."""
        basis = self._basis
        along_mean = (basis.scale * (basis.components @ basis.mean)).astype(np.float32)
        square = np.empty(len(codes), np.float32)
        for begin in range(0, len(codes), _ROWS):
            steps = codes[begin : begin + _ROWS].astype(np.float32)
            of_mean = steps @ along_mean
            steps *= basis.scale
            square[begin : begin + _ROWS] = 2 * of_mean + np.einsum("nk,nk->n", steps, steps)
        square += np.float32(basis.mean @ basis.mean)
        return np.asarray(np.sqrt(np.maximum(square, 1e-12)))

    def _best(self, codes: Ints, length: Floats, words: Floats) -> Floats:
        """Return (n,) cosine of each feature with the nearest of some words."""
        basis = self._basis
        projected = (basis.scale[:, None] * (basis.components @ words.T)).astype(
            np.float32
        )  # (COMPONENTS, t)
        offset = (basis.mean @ words.T).astype(np.float32)
        best = np.empty(len(codes), np.float32)
        work: Array = np.empty((_ROWS, COMPONENTS), np.float32)
        for begin in range(0, len(codes), _ROWS):
            part = codes[begin : begin + _ROWS]
            steps = work[: len(part)]
            np.copyto(steps, part)
            # One row a word: the maximum over rows is a pass over whole vectors.
            dot = projected.T @ steps.T
            dot += offset[:, None]
            dot.max(axis=0, out=best[begin : begin + _ROWS])
        return np.asarray(best / length)
