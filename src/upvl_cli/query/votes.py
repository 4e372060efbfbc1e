"""Which kind each box is: its points vote, or its mean feature alone (UP-VL, Section 3.5).

A point takes the word of highest cosine; a box takes the kind that most of its points voted for, all words of a
kind together. Of kinds with equally many votes the one whose votes have the higher mean cosine wins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.types import Bools, Floats, Ints

NONE = -1
FEWER = 32  # a track has some tens of boxes, often all of them among the best


@dataclass(frozen=True)
class Answers:
    """What boxes are.

    Attributes:
        kind: (b,) the kind that won; `NONE` for a box without points.
        word: (b,) the word of that kind with the most votes, the first of several; `NONE` without points.
        share: (b,) share of the votes that the kind has, 0 to 1.
        cosine: (b,) mean cosine of the votes for the kind.
    """

    kind: Ints
    word: Ints
    share: Floats
    cosine: Floats


def vote(cosines: Floats, of_box: Ints, boxes: int, kind_of_word: Ints) -> Answers:
    """Let the points of each box vote; with one mean feature a box, that decides alone.

    Args:
        cosines: (n, t) of each point with each word.
        of_box: (n,) the box of each point.
        boxes: How many boxes there are.
        kind_of_word: (t,) ascending from 0, without gaps.
    """
    words, kinds = len(kind_of_word), int(kind_of_word[-1]) + 1
    chosen = cosines.argmax(axis=1)
    nearest = cosines[np.arange(len(chosen)), chosen]
    box = np.asarray(of_box, dtype=np.int64)
    per_word = np.bincount(box * words + chosen, minlength=boxes * words).reshape(boxes, words)
    ballots = box * kinds + kind_of_word[chosen]
    votes = np.bincount(ballots, minlength=boxes * kinds).reshape(boxes, kinds)
    total = np.bincount(ballots, nearest, minlength=boxes * kinds).reshape(boxes, kinds)
    mean = total / np.maximum(votes, 1)
    kind = np.where(votes == votes.max(axis=1, keepdims=True), mean, -np.inf).argmax(axis=1)
    word = np.where(kind_of_word == kind[:, None], per_word, -1).argmax(axis=1)
    every, count = np.arange(boxes), votes.sum(axis=1)
    return Answers(
        np.where(count > 0, kind, NONE),
        np.where(count > 0, word, NONE),
        votes[every, kind] / np.maximum(count, 1),
        mean[every, kind],
    )


def rank(cosines: Floats, asked: Bools) -> Floats:
    """(n,) how promising each object is: its best asked word less its best other word.

    Args:
        cosines: (n, t) of pooled features.
        asked: (t,) which words are asked for; at least one.
    """
    best = cosines[:, asked].max(axis=1)
    return np.asarray(best if asked.all() else best - cosines[:, ~asked].max(axis=1))


def first_of_each(score: Floats, group: Ints, most: int) -> Ints:
    """Places of the best of each group, best first, at most so many.

    Args:
        score: (n,) higher is better; of equals the first counts.
        group: (n,) what belongs together; those with a number below 0 stand alone.
        most: How many to give.
    """
    size = most
    while True:
        size = min(size * FEWER, len(score))
        # All that are as good as the last of so many: quicker than to sort all.
        place = np.flatnonzero(score >= np.partition(score, -size)[-size]) if size else np.zeros(0, np.int64)
        chosen = _first(place[np.argsort(-score[place], kind="stable")], group, most)
        if len(chosen) == most or size == len(score):
            return chosen


def _first(places: Ints, group: Ints, most: int) -> Ints:
    seen: set[int] = set()
    chosen: list[int] = []
    for place in places.tolist():
        if len(chosen) == most:
            break
        number = int(group[place])
        if number < 0 or number not in seen:
            seen.add(number)
            chosen.append(place)
    return np.array(chosen, dtype=np.int64)
