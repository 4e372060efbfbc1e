"""Assignment of predictions to labels in one frame: the official matchers, and a quick one for few pairs.

Source: waymo-open-dataset 99a4cb3, metrics/matcher.cc and metrics/hungarian.cc.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from upvl_cli.metrics.waymo.score_order import order_by_score
from upvl_cli.types import Array, Floats, Ints

Pair = tuple[int, int, int]  # prediction, label, weight


def weights_of(iou: Floats) -> Ints:
    """Return (e,) the integer that the official matcher adds up: IoU in millionths, rounded as float32.

    Args:
        iou: (e,) IoU.
    """
    scaled = np.asarray(iou, dtype=np.float32) * np.float32(1e6)
    return np.floor(scaled.astype(np.float64) + 0.5).astype(np.int64)


def heaviest_matching(pairs: Sequence[Pair]) -> tuple[list[int], list[int]]:
    """Return which pairs make the matching of most weight, and all pairs where another matching weighs as much.

    Args:
        pairs: Pairs of positive weight; none twice.
    """
    if len(pairs) < 2:
        return list(range(len(pairs))), []
    rows = {p: i for i, p in enumerate(dict.fromkeys(pair[0] for pair in pairs))}
    columns = {t: i for i, t in enumerate(dict.fromkeys(pair[1] for pair in pairs))}
    if len(rows) == 1 or len(columns) == 1:
        weights = [pair[2] for pair in pairs]
        top = [i for i, w in enumerate(weights) if w == max(weights)]
        return top[:1], top[1:] and top
    if len(rows) == len(columns) == len(pairs):
        return list(range(len(pairs))), []
    weight = np.zeros((len(rows), len(columns)), dtype=np.int64)
    number = {}
    for i, (p, t, w) in enumerate(pairs):
        weight[rows[p], columns[t]] = w
        number[rows[p], columns[t]] = i
    best, total = _best_assignment(weight)
    tied = any(_weight_without(weight, cell) == total for cell in best)
    return [number[cell] for cell in best], list(range(len(pairs))) if tied else []


def _best_assignment(weight: Ints) -> tuple[list[tuple[int, int]], int]:
    row, column = linear_sum_assignment(weight, maximize=True)
    matched = weight[row, column]
    used = matched > 0
    return list(zip(row[used].tolist(), column[used].tolist(), strict=True)), int(matched.sum())


def _weight_without(weight: Ints, cell: tuple[int, int]) -> int:
    """Return the most weight of a matching without this pair; as much as with it where the best is a tie."""
    rest = weight.copy()
    rest[cell] = 0
    return _best_assignment(rest)[1]


def official_hungarian(weight: Ints) -> Ints:
    """Return (p,) the column of each row, -1 for none; ties fall as in the official Kuhn-Munkres.

    The table is made square with zeros. Rows are matched from first to last: a tree of tight edges grows
    from the row, breadth first and by ascending column, until it meets a free column; labels move when no
    tight edge leaves the tree.

    Args:
        weight: (p, t) weights of all pairs, 0 for none.
    """
    n = max(weight.shape)
    square = np.pad(weight, ((0, n - weight.shape[0]), (0, n - weight.shape[1])))
    label_row, label_column = square.max(axis=1, initial=0), np.zeros(n, dtype=np.int64)
    column_of, row_of = np.full(n, -1), np.full(n, -1)
    for root in range(n):
        parent, column = _tree(square, label_row, label_column, row_of, root)
        while column >= 0:  # flip the path from the free column back to the root
            row = parent[column]
            row_of[column], column_of[row], column = row, column, column_of[row]
    column_of = column_of[: weight.shape[0]]
    return np.where(square[np.arange(len(column_of)), column_of] > 0, column_of, -1)


def _tree(
    weight: Ints, label_row: Ints, label_column: Ints, row_of: Ints, root: int
) -> tuple[dict[int, int], int]:
    """Return the row before each column of the tree, and the free column that it met; changes the labels in place."""
    rows, parent = [root], dict[int, int]()
    reached = _tight(weight, label_row, label_column, rows)
    while True:
        if len(parent) == len(reached):
            _relabel(weight, label_row, label_column, rows, list(parent))
            reached = _tight(weight, label_row, label_column, rows)
        column = next(c for c in reached if c not in parent)
        parent[column] = reached[column]
        if row_of[column] < 0:
            return parent, column
        rows.append(int(row_of[column]))
        for new, row in _tight(weight, label_row, label_column, rows[-1:]).items():
            reached.setdefault(new, row)


def _tight(weight: Ints, label_row: Ints, label_column: Ints, rows: list[int]) -> dict[int, int]:
    """Return the columns on a tight edge of these rows, by row then column, each with its first row."""
    reached: dict[int, int] = {}
    for row in rows:
        for column in np.flatnonzero(label_row[row] + label_column == weight[row]).tolist():
            reached.setdefault(column, row)
    return reached


def _relabel(weight: Ints, label_row: Ints, label_column: Ints, rows: list[int], taken: list[int]) -> None:
    """Lower the labels of the tree's rows, and raise those of its columns, until another edge is tight."""
    slack = label_row[rows, None] + label_column - weight[rows]
    slack[:, taken] = np.iinfo(np.int64).max
    step = slack.min()
    label_row[rows] -= step
    label_column[taken] += step


def official_score_first(matchable: Array, weight: Ints, score: Floats) -> Ints:
    """Return (p,) the label of each prediction, -1 for none: greedily by descending score, the best free one.

    Args:
        matchable: (p, t) whether a pair reaches the threshold.
        weight: (p, t) what the matcher compares. The official one looks it up under the wrong numbers
            (matcher.cc:283), so that it can belong to other boxes than the pair.
        score: (p,) confidence.
    """
    label_of = np.full(len(score), -1)
    free = np.ones(matchable.shape[1], dtype=np.bool_)
    for p in order_by_score(score):
        candidates = np.flatnonzero(free & matchable[p])
        if len(candidates):
            label_of[p] = candidates[np.argmax(weight[p, candidates])]
            free[label_of[p]] = False
    return label_of


def match_by_score(pairs: Sequence[Pair], score: Sequence[float]) -> list[int]:
    """Return which pairs a greedy matching takes: each prediction, by descending score, its heaviest free label.

    Args:
        pairs: Pairs that reach the threshold.
        score: Confidence of each pair's prediction.
    """
    taken: list[int] = []
    used: set[tuple[str, int]] = set()
    for i in sorted(range(len(pairs)), key=lambda i: (-score[i], pairs[i][0], -pairs[i][2], pairs[i][1])):
        ends = {("prediction", pairs[i][0]), ("label", pairs[i][1])}
        if not ends & used:
            used |= ends
            taken.append(i)
    return taken
