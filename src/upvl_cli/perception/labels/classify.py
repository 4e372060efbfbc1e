"""Class of each track by a majority vote of its points (UP-VL, Section 3.5)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.perception.labels.classes import OTHER
from upvl_cli.types import Array, Boxes, Floats, Ints, Ragged

NO_WORD = -1


class TrackClasses(NamedTuple):
    """Classes of some tracks.

    Attributes:
        type: (b,) int8 number of the class, `OTHER` without a vote.
        word: (b,) int16 number of the best word of that class, `NO_WORD` without a vote.
        share: (b,) float32 share of the votes of the track that the class has, 0 without a vote.
    """

    type: Ints
    word: Ints
    share: Floats


class WordVotes:
    """Votes of points for words, counted track by track, so that an object has one class in all frames."""

    def __init__(self, type_of_word: Ints, cosines: Callable[[Ints], Floats]) -> None:
        """Start without a vote.

        Args:
            type_of_word: (t,) the class that each word is for.
            cosines: Gives (m, t) of m features with each word; the largest one has the vote.
        """
        self._type_of_word = np.asarray(type_of_word)
        self._cosines = cosines
        self._votes: dict[int, Ints] = {}

    def add_sweep(self, boxes: Boxes, track_id: Ints, xyz_m: Array, feature: Ints) -> None:
        """Count the votes of the points of one frame for the boxes that they lie in.

        Args:
            boxes: b boxes.
            track_id: (b,) their tracks.
            xyz_m: (n, 3) points with a feature, in the axes of the boxes.
            feature: (n, ...) their features.
        """
        box, point = pairs_inside(xyz_m, boxes, margin_m=0.0)
        if not len(point):
            return
        voters, row = np.unique(point, return_inverse=True)  # a point in two boxes is compared once
        self._count(track_id, box, self._cosines(feature[voters]).argmax(axis=1)[row])

    def add_point_features(self, track_id: Ints, point_feature: Ragged) -> None:
        """Count the votes of the points of one frame whose boxes are known.

        Args:
            track_id: (b,) the track of each box.
            point_feature: For each box the features of its points.
        """
        if len(point_feature.values):
            word = self._cosines(point_feature.values).argmax(axis=1)
            self._count(track_id, point_feature.owner, word)

    def _count(self, track_id: Ints, box: Ints, word: Ints) -> None:
        words = len(self._type_of_word)
        for number in track_id.tolist():
            self._votes.setdefault(number, np.zeros(words, dtype=np.int64))
        for number in np.unique(box):
            self._votes[int(track_id[number])] += np.bincount(word[box == number], minlength=words)

    def classify(self, track_id: Ints) -> TrackClasses:
        """Return the class of each track.

        The class with the most votes wins, all its words together; of equal ones that of the smaller number. The
        word is the one with the most votes of that class.

        Args:
            track_id: (b,) tracks.
        """
        class_number = np.full(len(track_id), OTHER, np.int8)
        word, share = np.full(len(track_id), NO_WORD, np.int16), np.zeros(len(track_id), np.float32)
        classes = np.unique(self._type_of_word)
        for row, number in enumerate(track_id.tolist()):
            votes = self._votes.get(number)
            if votes is None or not votes.any():
                continue
            sums = np.array([votes[self._type_of_word == each].sum() for each in classes])
            class_number[row] = classes[sums.argmax()]
            word[row] = np.where(self._type_of_word == class_number[row], votes, -1).argmax()
            share[row] = sums.max() / votes.sum()
        return TrackClasses(class_number, word, share)
