"""Words that looks at an object name, and how they and the votes of its points choose one together."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Bools, Floats, Ints


def look_shares(cosines: Floats, class_of_word: Ints, temperature: float) -> Floats:
    """Return (n, t) the share that each word has of each look; they sum to 1.

    A class has as much as its nearest word, and the words of a class divide that: a class of many words is not
    likelier than one of few.

    Args:
        cosines: (n, t) of each look with each word.
        class_of_word: (t,) numbers of classes, in any order.
        temperature: Of the softmax over cosines.
    """
    classes, column = np.unique(class_of_word, return_inverse=True)
    odds = np.exp((cosines - cosines.max(axis=1, keepdims=True)).astype(np.float64) / temperature)
    best, total = np.zeros((len(odds), len(classes))), np.zeros((len(odds), len(classes)))
    words = np.bincount(column, minlength=len(classes))
    single = words[column] == 1
    best[:, column[single]] = total[:, column[single]] = odds[:, single]
    for number in np.flatnonzero(words > 1).tolist():
        own = odds[:, column == number]
        best[:, number], total[:, number] = own.max(axis=1), own.sum(axis=1)
    of_class = best / best.sum(axis=1, keepdims=True)
    # A word that is very far from a look may have odds of zero, and its class with it.
    return np.asarray(odds * (of_class / np.maximum(total, 1e-300))[:, column])


def combined_shares(points: Floats, looks: Floats, has_looks: Bools, weight: float) -> Floats:
    """Return (n, t) shares of words by both; where one of them is missing, by the other alone.

    Args:
        points: (n, t) votes of the points for each word; none where a row is zero.
        looks: (n, t) shares of the looks.
        has_looks: (n,) whether there are any.
        weight: Weight of the looks where there are both; that of the points is 1 less this.
    """
    votes = points.sum(axis=1, keepdims=True)
    has_points = votes > 0
    of_looks = np.where(has_looks[:, None], np.where(has_points, weight, 1.0), 0.0)
    by_points = points / np.maximum(votes, 1)
    return np.asarray(np.where(has_points, 1 - of_looks, 0.0) * by_points + of_looks * looks)
