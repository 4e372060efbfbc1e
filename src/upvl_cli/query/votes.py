"""Which class each box has: the vote of its points, or its mean feature alone (UP-VL, Section 3.5); and its looks.

A point votes for the word of highest cosine; a box has the class with the most votes, all words of a class together.
Of classes with equally many votes the one whose votes have the higher mean cosine wins. Looks at the track of a box
give each word a share too (`perception.labels.look_votes`), and the largest share of both decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.perception.labels.look_votes import combined_shares
from upvl_cli.types import Bools, Floats, Ints

NO_CLASS = -1
_BOXES_PER_GROUP = 32  # a track has some tens of boxes, often all of them among the best


@dataclass(frozen=True)
class VoteResult:
    """The classes of b boxes.

    Attributes:
        class_index: (b,) the class that won; `NO_CLASS` for a box without points and looks.
        word_index: (b,) the word of that class with the largest share, the first of equals; `NO_CLASS` without both.
        share: (b,) share that the class has, 0 to 1.
        cosine: (b,) mean cosine of the votes for the class; that of the looks where no point votes for it.
    """

    class_index: Ints
    word_index: Ints
    share: Floats
    cosine: Floats


@dataclass(frozen=True)
class LookShares:
    """What looks at the tracks of b boxes name.

    Attributes:
        share: (b, t) share of each word, summing to 1 where there is a look.
        cosine: (b, t) cosine of each look with each word.
        is_known: (b,) whether there is a look.
        weight: Weight of the looks where points vote too; theirs is 1 less this.
    """

    share: Floats
    cosine: Floats
    is_known: Bools
    weight: float


def vote(
    cosines: Floats, box_of_point: Ints, boxes: int, class_of_word: Ints, looks: LookShares | None = None
) -> VoteResult:
    """Return the class that most points of each box vote for; a box with one mean feature has one vote.

    Args:
        cosines: (n, t) of each point with each word.
        box_of_point: (n,) the box of each point.
        boxes: How many boxes there are.
        class_of_word: (t,) ascending from 0, without gaps.
        looks: What looks name; None where points alone decide.
    """
    words, classes = len(class_of_word), int(class_of_word[-1]) + 1
    best_word = cosines.argmax(axis=1)
    best_cosine = cosines[np.arange(len(best_word)), best_word]
    box = np.asarray(box_of_point, dtype=np.int64)
    votes_per_word = np.bincount(box * words + best_word, minlength=boxes * words).reshape(boxes, words)
    ballots = box * classes + class_of_word[best_word]
    votes = np.bincount(ballots, minlength=boxes * classes).reshape(boxes, classes)
    total = np.bincount(ballots, best_cosine, minlength=boxes * classes).reshape(boxes, classes)
    mean = total / np.maximum(votes, 1)
    share = votes / np.maximum(votes.sum(axis=1, keepdims=True), 1)
    word_share: Floats = votes_per_word.astype(np.float64)
    if looks is not None:
        word_share = combined_shares(word_share, looks.share, looks.is_known, looks.weight)
        first = np.searchsorted(class_of_word, np.arange(classes))
        share = np.where(looks.is_known[:, None], np.add.reduceat(word_share, first, axis=1), share)
        of_look = np.maximum.reduceat(looks.cosine, first, axis=1)
        mean = np.where((votes == 0) & looks.is_known[:, None], of_look, mean)
    winner = np.where(share == share.max(axis=1, keepdims=True), mean, -np.inf).argmax(axis=1)
    word = np.where(class_of_word == winner[:, None], word_share, -1).argmax(axis=1)
    every, is_known = np.arange(boxes), share.any(axis=1)
    return VoteResult(
        np.where(is_known, winner, NO_CLASS),
        np.where(is_known, word, NO_CLASS),
        share[every, winner],
        mean[every, winner],
    )


def best_of_groups(score: Floats, group: Ints, limit: int) -> Ints:
    """Return the index of the best item of each group, best first.

    Args:
        score: (n,) higher is better; of equals the first wins.
        group: (n,) number of the group of each item; an item with a negative number is a group of its own.
        limit: How many to return at most.
    """
    size = limit
    while True:
        size = min(size * _BOXES_PER_GROUP, len(score))
        # All items as good as the last of that many: faster than to sort all.
        index = np.flatnonzero(score >= np.partition(score, -size)[-size]) if size else np.zeros(0, np.int64)
        best = _first_of_groups(index[np.argsort(-score[index], kind="stable")], group, limit)
        if len(best) == limit or size == len(score):
            return best


def _first_of_groups(ordered: Ints, group: Ints, limit: int) -> Ints:
    seen: set[int] = set()
    first: list[int] = []
    for index in ordered.tolist():
        if len(first) == limit:
            break
        number = int(group[index])
        if number < 0 or number not in seen:
            seen.add(number)
            first.append(index)
    return np.array(first, dtype=np.int64)
