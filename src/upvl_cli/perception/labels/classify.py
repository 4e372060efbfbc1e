"""Class of each track: a vote of its points (UP-VL, Section 3.5), and what looks at it name."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.perception.labels.classes import OTHER
from upvl_cli.perception.labels.look_votes import combined_shares
from upvl_cli.types import Array, Bools, Boxes, Floats, Ints, Ragged

NO_WORD = -1
TOP_WORDS = 3  # of a look that are kept
_DIGITS = 9  # of sums of shares, so that equal numbers of votes stay equal


class TrackClasses(NamedTuple):
    """Classes of some tracks.

    Attributes:
        type: (b,) int8 number of the class, `OTHER` without a vote and a look.
        word: (b,) int16 number of the best word of that class, `NO_WORD` without both.
        share: (b,) float32 share that the class has, 0 without both.
        look_word: (b, TOP_WORDS) int16 best words of the looks, of all classes; `NO_WORD` without a look.
        look_share: (b, TOP_WORDS) float32 their shares among all words, 0 without a look.
        agree: (b,) whether the points alone and the looks alone have the same class, or one of them is missing.
    """

    type: Ints
    word: Ints
    share: Floats
    look_word: Ints
    look_share: Floats
    agree: Bools


class WordVotes:
    """Votes of points for words, counted track by track, so that an object has one class in all frames."""

    def __init__(
        self, type_of_word: Ints, cosines: Callable[[Ints], Floats], look_weight: float = 0.5
    ) -> None:
        """Start without a vote.

        Args:
            type_of_word: (t,) the class that each word is for.
            cosines: Gives (m, t) of m features with each word, or with the first words alone: then no point votes for
                the others; the largest one has the vote.
            look_weight: Weight of the looks at a track whose points vote too; theirs is 1 less this.
        """
        self._type_of_word = np.asarray(type_of_word)
        self._cosines = cosines
        self._look_weight = look_weight
        self._votes: dict[int, Ints] = {}
        self._looks: dict[int, Floats] = {}

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

    def add_looks(self, track_id: Ints, shares: Floats) -> None:
        """Take what looks at some tracks name.

        Args:
            track_id: (b,) tracks.
            shares: (b, t) share of each word, summing to 1 (`look_votes.look_shares`).
        """
        self._looks.update(zip(track_id.tolist(), shares, strict=True))

    def _count(self, track_id: Ints, box: Ints, word: Ints) -> None:
        words = len(self._type_of_word)
        for number in track_id.tolist():
            self._votes.setdefault(number, np.zeros(words, dtype=np.int64))
        for number in np.unique(box):
            self._votes[int(track_id[number])] += np.bincount(word[box == number], minlength=words)

    def classify(self, track_id: Ints) -> TrackClasses:
        """Return the class of each track.

        The class with the largest share wins, all its words together; of equal ones that of the smaller number. The
        word is the one with the largest share of that class.

        Args:
            track_id: (b,) tracks.
        """
        tracks, none = track_id.tolist(), np.zeros(len(self._type_of_word))
        points = np.array([self._votes.get(track, none) for track in tracks]).reshape(-1, len(none))
        looks = np.array([self._looks.get(track, none) for track in tracks]).reshape(-1, len(none))
        has_looks = np.asarray(looks.any(axis=1))
        share = combined_shares(points, looks, has_looks, self._look_weight)
        class_number, class_share = self._best_class(share)
        is_known = share.any(axis=1)
        word = np.where(self._type_of_word == class_number[:, None], share, -1).argmax(axis=1)
        top = np.argsort(-looks, axis=1, kind="stable")[:, :TOP_WORDS]
        filled = [(0, 0), (0, TOP_WORDS - top.shape[1])]
        return TrackClasses(
            np.where(is_known, class_number, OTHER).astype(np.int8),
            np.where(is_known, word, NO_WORD).astype(np.int16),
            class_share.astype(np.float32),
            np.pad(np.where(has_looks[:, None], top, NO_WORD), filled, constant_values=NO_WORD).astype(
                np.int16
            ),
            np.pad(np.take_along_axis(looks, top, axis=1), filled).astype(np.float32),
            ~has_looks | ~points.any(axis=1) | (self._best_class(points)[0] == self._best_class(looks)[0]),
        )

    def _best_class(self, share: Floats) -> tuple[Ints, Floats]:
        """Return (b,) the class of the largest sum of (b, t) shares, and that sum."""
        classes = np.unique(self._type_of_word)
        sums = np.stack([share[:, self._type_of_word == each].sum(axis=1) for each in classes], axis=1)
        best = sums.round(_DIGITS).argmax(axis=1)
        return classes[best], sums.max(axis=1)
