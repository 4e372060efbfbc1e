"""Which boxes are worth ranking: the vectors of the lists that are nearest to the words, out of all groups of drives.

A search ranks by the best queried word less the best negative, which is no dot product with one vector. So the centres
of the lists are scored like boxes, the lists with the most promising centres are read, and each of their vectors is
scored with all words. The tracks that come out best are then ranked exactly, by all of their boxes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.perception.visual.open_vocabulary import Basis
from upvl_cli.query.candidates import Candidates
from upvl_cli.query.index import Objects
from upvl_cli.query.store import Store
from upvl_cli.query.vector_files import DIM, VectorFile, read_stamp
from upvl_cli.query.vocabulary import Vocabulary
from upvl_cli.runtime.parallel import in_order
from upvl_cli.types import Array, Bools, Floats, Ints

# Of the vectors of a fleet: a sixth of the first ten million, and a thirtieth of the others (bench/index.py).
_FEW_VECTORS, _FEW_SHARE, _MANY_SHARE = 10_000_000, 1 / 6, 1 / 30
# Standard deviations of the scores in a list by which its best vector exceeds its centre.
_SIGMAS = 3.0
_TRACKS_PER_CANDIDATE = 4  # that are ranked exactly, as eight bits a component err
_VECTORS_PER_TRACK = 64
_ROWS = 4096  # scored at once: a megabyte in single precision, which stays in the cache of a core


@dataclass(frozen=True)
class Vectors:
    """The files of vectors that fit the stored boxes.

    Attributes:
        files: One a group of drives.
        covers: Of each file which of its drives are searched by it: others have changed since, or are gone.
    """

    files: tuple[VectorFile, ...] = ()
    covers: tuple[Bools, ...] = ()

    @property
    def drives(self) -> frozenset[str]:
        """The names of the drives that need no exact search."""
        return frozenset(
            name
            for file, covered in zip(self.files, self.covers, strict=True)
            for (name, _, _), known in zip(file.stamp.drives, covered.tolist(), strict=True)
            if known
        )


@dataclass(frozen=True)
class _Found:
    """Vectors of one file: (n,) score, row among the boxes of the group, and whether it is of looks."""

    score: Floats
    row: Ints
    is_look: Bools


def open_vectors(store: Store, drives: Mapping[str, Objects], digests: Mapping[str, str]) -> Vectors:
    """Return the files of vectors of which at least one drive is as it was when they were made.

    Args:
        store: The stored boxes.
        drives: The boxes of each drive.
        digests: What they were read from, as of `ObjectIndex`.
    """
    files: list[VectorFile] = []
    covers: list[Bools] = []
    known: set[str] = set()
    for path in sorted(store.index.glob(f"{store.source}-*.faiss")) if store.index.is_dir() else []:
        stamp = read_stamp(path)
        if stamp is None:
            continue
        fits = np.array(
            [
                name not in known and digests.get(name) == digest and len(drives[name]) == boxes
                for name, digest, boxes in stamp.drives
            ],
            np.bool_,
        )
        file = VectorFile.open(path, stamp) if fits.any() else None
        if file is not None:
            files.append(file)
            covers.append(fits)
            known.update(name for (name, _, _), fit in zip(stamp.drives, fits.tolist(), strict=True) if fit)
    return Vectors(tuple(files), tuple(covers))


def narrow(
    vectors: Vectors,
    basis: Basis,
    vocabulary: Vocabulary,
    candidates: Sequence[Candidates],
    *,
    tracks: int,
    uses_looks: bool,
) -> list[Candidates]:
    """Return the candidates with the boxes of the most promising tracks alone, in all drives that have vectors.

    Args:
        vectors: The files of vectors.
        basis: Basis of the features.
        vocabulary: The words.
        candidates: The boxes that may be found, by drive.
        tracks: How many tracks the ranking will choose.
        uses_looks: Whether looks count.
    """
    by_drive = {chosen.segment: number for number, chosen in enumerate(candidates)}
    search = _Search(vectors, basis, vocabulary, candidates, by_drive, uses_looks)
    kept = search.best_tracks(tracks * _TRACKS_PER_CANDIDATE)
    drives = vectors.drives
    return [
        chosen if chosen.segment not in drives else replace(chosen, rows=kept.get(number, chosen.rows[:0]))
        for number, chosen in enumerate(candidates)
    ]


class _Search:
    """One search of the files of vectors."""

    def __init__(
        self,
        vectors: Vectors,
        basis: Basis,
        vocabulary: Vocabulary,
        candidates: Sequence[Candidates],
        by_drive: Mapping[str, int],
        uses_looks: bool,
    ) -> None:
        self._candidates = candidates
        self._uses_looks = uses_looks
        self._words = basis.compact_words(vocabulary.vectors)
        self._queried = int(vocabulary.is_queried.sum())
        # The candidates of each drive of each file; -1 for a drive that is not searched here.
        self._drives = [
            np.array(
                [
                    by_drive.get(name, -1) if known else -1
                    for (name, _, _), known in zip(file.stamp.drives, covered.tolist(), strict=True)
                ],
                np.int64,
            )
            for file, covered in zip(vectors.files, vectors.covers, strict=True)
        ]
        self._files = vectors.files
        self._passes = list(in_order(self._passing, range(len(self._files))))

    def best_tracks(self, tracks: int) -> dict[int, Ints]:
        """Return the rows of the best tracks, by number of the candidates."""
        passes = self._passes
        lists = self._promising_lists(passes)
        used = [number for number, chosen in enumerate(lists) if len(chosen)]
        found = list(in_order(lambda number: self._scan(number, lists[number], passes[number]), used))
        most = tracks * _VECTORS_PER_TRACK
        total = sum(len(part.score) for part in found)
        while True:
            best = self._best_of(used, found, min(most, total))
            if len(best) >= tracks or most >= total:
                return self._rows_of(best[:tracks])
            most *= 8

    def _passing(self, number: int) -> Bools:
        """Return which boxes of a group are candidates."""
        file = self._files[number]
        passes = np.zeros(int(file.first_row[-1]), np.bool_)
        for first, drive in zip(file.first_row.tolist(), self._drives[number].tolist(), strict=False):
            if drive >= 0:
                passes[first + self._candidates[drive].rows] = True
        return passes

    def _promising_lists(self, passes: Sequence[Bools]) -> list[Ints]:
        """Return the lists to read of each file, so many that enough of their vectors are of candidates."""
        bound = np.concatenate([self._bound(file.center) for file in self._files])
        share = [float(part.mean()) if len(part) else 0.0 for part in passes]
        expected = np.concatenate([file.size * part for file, part in zip(self._files, share, strict=True)])
        wanted = _FEW_SHARE * min(expected.sum(), _FEW_VECTORS)
        wanted += _MANY_SHARE * max(expected.sum() - _FEW_VECTORS, 0)
        order = np.argsort(-bound, kind="stable")
        order = order[expected[order] > 0]
        order = order[: 1 + int(np.searchsorted(np.cumsum(expected[order]), wanted))]
        first = np.cumsum([0, *(len(file.size) for file in self._files)])
        return [
            np.sort(order[(order >= begin) & (order < end)]) - begin
            for begin, end in zip(first[:-1], first[1:], strict=True)
        ]

    def _bound(self, center: Floats) -> Floats:
        """Return (lists,) what the best vector of a list of usual spread may score.

        The vectors of a list have length 1, so the length of their mean says how far they are from it, on average;
        a share of it lies along the difference of the two words that decide.
        """
        cosines = center @ self._words.T
        word = cosines[:, : self._queried].argmax(axis=1)
        best = self._words[word]
        score = cosines[np.arange(len(center)), word]
        if len(self._words) > self._queried:
            against = self._queried + cosines[:, self._queried :].argmax(axis=1)
            score = score - cosines[np.arange(len(center)), against]
            best = best - self._words[against]
        radius = np.sqrt(np.maximum(1 - np.einsum("nk,nk->n", center, center), 0) / DIM)
        return np.asarray(score + _SIGMAS * radius * np.linalg.norm(best, axis=1))

    def _scan(self, number: int, lists: Ints, passes: Bools) -> _Found:
        """Return the vectors of some lists that are of candidates, and their scores."""
        file = self._files[number]
        codes, entries = file.read(lists)
        row, is_look = entries >> 1, (entries & 1).astype(np.bool_)
        inside = (row >= 0) & (row < len(passes))
        # The looks are those of a track, of which another box may be the candidate.
        usable = inside & (is_look & self._uses_looks | ~is_look & passes[np.where(inside, row, 0)])
        if not usable.all():
            codes, row, is_look = codes[usable], row[usable], is_look[usable]
        return _Found(self._score(file, codes), row, is_look)

    def _score(self, file: VectorFile, codes: Array) -> Floats:
        factors, summands = file.words(self._words)
        score = np.empty(len(codes), np.float32)
        work: Array = np.empty((_ROWS, DIM), np.float32)
        for begin in range(0, len(codes), _ROWS):
            part = codes[begin : begin + _ROWS]
            np.copyto(work[: len(part)], part)
            cosines = factors @ work[: len(part)].T
            cosines += summands[:, None]
            best = cosines[: self._queried].max(axis=0)
            if len(cosines) > self._queried:
                best -= cosines[self._queried :].max(axis=0)
            score[begin : begin + _ROWS] = best
        return score

    def _best_of(self, used: Sequence[int], found: Sequence[_Found], most: int) -> list[tuple[int, int]]:
        """Return number of the candidates and one row of each track among the vectors of the highest scores."""
        if not most:
            return []
        score = np.concatenate([part.score for part in found])
        best = np.argpartition(score, -most)[-most:]
        best = best[np.argsort(-score[best], kind="stable")]
        first = np.cumsum([0, *(len(part.score) for part in found)])
        part_of = np.searchsorted(first, best, side="right") - 1
        drive, row, track = (np.empty(len(best), np.int64) for _ in range(3))
        is_look = np.empty(len(best), np.bool_)
        for place, number in enumerate(used):
            here = np.flatnonzero(part_of == place)
            entry = best[here] - first[place]
            group_row = found[place].row[entry]
            owner = np.searchsorted(self._files[number].first_row, group_row, side="right") - 1
            drive[here] = self._drives[number][owner]
            row[here] = group_row - self._files[number].first_row[owner]
            is_look[here] = found[place].is_look[entry]
        for known in np.unique(drive[drive >= 0]).tolist():
            here = np.flatnonzero(drive == known)
            chosen = self._candidates[known]
            track[here] = chosen.objects.track_id[row[here]]
            # Looks whose own box is no candidate: they count where another box of the track is one.
            looks = here[is_look[here]]
            looks = looks[~_are_among(row[looks], chosen.rows)]
            if len(looks):
                others = np.isin(track[looks], chosen.objects.track_id[chosen.rows]) & (track[looks] >= 0)
                drive[looks[~others]] = -1
        key = np.stack([drive, np.where(track < 0, -1 - row, track)], axis=1)
        first_of_key = np.sort(np.unique(key, axis=0, return_index=True)[1])
        return [(int(drive[place]), int(row[place])) for place in first_of_key.tolist() if drive[place] >= 0]

    def _rows_of(self, best: Sequence[tuple[int, int]]) -> dict[int, Ints]:
        """Return the candidates of some tracks, ascending, by number of the candidates."""
        rows: dict[int, list[int]] = {}
        for drive, row in best:
            rows.setdefault(drive, []).append(row)
        kept = {}
        for drive, chosen_rows in rows.items():
            chosen = self._candidates[drive]
            track = chosen.objects.track_id[chosen.rows]
            wanted = chosen.objects.track_id[chosen_rows]
            same = np.zeros(len(track), np.bool_)
            for number in np.unique(wanted[wanted >= 0]).tolist():
                same |= track == number
            own = np.array(chosen_rows, np.int64)
            same[np.searchsorted(chosen.rows, own[_are_among(own, chosen.rows)])] = True
            kept[drive] = chosen.rows[same]
        return kept


def _are_among(values: Ints, ascending: Ints) -> Bools:
    """Return which values are among some ascending ones."""
    if not len(ascending):
        return np.zeros(len(values), np.bool_)
    place = np.minimum(np.searchsorted(ascending, values), len(ascending) - 1)
    return np.asarray(ascending[place] == values)
