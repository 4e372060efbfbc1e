"""The order of predictions by score, with equal scores in the order of the official tool.

It sorts with std::sort, which is not stable. The GNU C++ library (bits/stl_algo.h) splits ranges of more
than 16 about the median of three and ends with an insertion sort; the same splits give the same order.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Floats, Ints

_SMALL = 16


def order_by_score(score: Floats) -> Ints:
    """Return (n,) numbers of the predictions by descending score.

    Args:
        score: (n,) confidence.
    """
    order, values = list(range(len(score))), score.tolist()
    ranges = [(0, len(order))]
    while ranges:
        first, last = ranges.pop()
        if last - first > _SMALL:
            cut = _split(order, values, first, last)
            ranges += [(first, cut), (cut, last)]
    return np.array(sorted(order, key=lambda i: -values[i]), dtype=np.int64)


def _split(order: list[int], score: list[float], first: int, last: int) -> int:
    """Part a range about a pivot, in place, and return where the second part begins."""
    ends = [first + 1, (first + last) // 2, last - 1]
    _swap(order, first, _median_place(ends, [score[order[i]] for i in ends]))
    pivot = score[order[first]]
    low, high = first + 1, last - 1
    while True:
        while score[order[low]] > pivot:
            low += 1
        while pivot > score[order[high]]:
            high -= 1
        if low >= high:
            return low
        _swap(order, low, high)
        low, high = low + 1, high - 1


def _median_place(places: list[int], score: list[float]) -> int:
    """Return the place of the middle score; which of equal ones is the library's choice."""
    (a, b, c), (x, y, z) = places, score
    if x > y:
        return b if y > z else c if x > z else a
    return a if x > z else c if y > z else b


def _swap(order: list[int], i: int, j: int) -> None:
    order[i], order[j] = order[j], order[i]
