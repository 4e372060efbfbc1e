"""Which word an object has: a majority vote of its points (UP-VL, Section 3.5)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.types import Array, Boxes, Floats, Ints

OTHER = 0
NO_WORD = -1


class Votes:
    """Counts the votes of points for words, track by track: what is one object has one name in all frames."""

    def __init__(self, kind_of_word: Ints, cosines: Callable[[Ints], Floats]) -> None:
        """Start without a vote.

        Args:
            kind_of_word: (t,) the kind that each word is for.
            cosines: Gives (m, t) of m features with each word.
        """
        self._kind_of_word = np.asarray(kind_of_word)
        self._cosines = cosines
        self._votes: dict[int, Ints] = {}

    def add(self, boxes: Boxes | Array, track_id: Ints, xyz_m: Array, feature: Ints) -> None:
        """Count the votes of the points in the boxes of one frame.

        Args:
            boxes: (b, 7) boxes.
            track_id: (b,) their tracks.
            xyz_m: (n, 3) points with a feature, in the axes of the boxes.
            feature: (n, ...) their features.
        """
        box, point = pairs_inside(xyz_m, boxes, margin_m=0.0)
        if not len(point):
            return
        chosen, place = np.unique(point, return_inverse=True)
        self._count(track_id, box, self._cosines(feature[chosen]).argmax(axis=1)[place])

    def add_features(self, track_id: Ints, of_box: Ints, feature: Ints) -> None:
        """Count the votes of the points of one frame that are known to be in boxes.

        Args:
            track_id: (b,) the track of each box.
            of_box: (n,) place of the box that each point is in.
            feature: (n, ...) their features.
        """
        if len(of_box):
            self._count(track_id, of_box, self._cosines(feature).argmax(axis=1))

    def _count(self, track_id: Ints, box: Ints, word: Ints) -> None:
        words = len(self._kind_of_word)
        for number, count in zip(track_id, np.zeros((len(track_id), words), dtype=np.int64), strict=True):
            self._votes.setdefault(int(number), count)
        for number in np.unique(box):
            self._votes[int(track_id[number])] += np.bincount(word[box == number], minlength=words)

    def of(self, track_id: Ints) -> tuple[Ints, Ints, Floats]:
        """(b,) kind, word and share of the votes of each track; `OTHER`, `NO_WORD` and 0 without a vote.

        The kind with the most votes wins, all its words together; the word is the best of that kind.
        """
        kind, word = np.full(len(track_id), OTHER, np.int8), np.full(len(track_id), NO_WORD, np.int16)
        share = np.zeros(len(track_id), np.float32)
        for place, number in enumerate(track_id.tolist()):
            votes = self._votes.get(number)
            if votes is None or not votes.any():
                continue
            kinds = np.unique(self._kind_of_word)
            sums = np.array([votes[self._kind_of_word == one].sum() for one in kinds])
            kind[place] = kinds[sums.argmax()]
            word[place] = np.where(self._kind_of_word == kind[place], votes, -1).argmax()
            share[place] = sums.max() / votes.sum()
        return kind, word, share
