"""Area shared by two rotated rectangles, in plain Python: slow, and exact with `Fraction` for number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any


def rectangle(box: Sequence[float], number: Any, origin: Sequence[float]) -> list[tuple[Any, Any]]:
    """Corners, counter-clockwise, of a box's floor as exact numbers (Fraction) or as floats."""
    x, y, _, length, width, _, heading = (float(value) for value in box)
    cos, sin = number(math.cos(heading)), number(math.sin(heading))
    corners = []
    for along, across in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        u, v = number(along) * number(length) / 2, number(across) * number(width) / 2
        corners.append(
            (
                number(x) - number(float(origin[0])) + u * cos - v * sin,
                number(y) - number(float(origin[1])) + u * sin + v * cos,
            )
        )
    return corners


def clip(subject: list[tuple[Any, Any]], window: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Sutherland and Hodgman: cut the subject by the half planes of the window, one at a time."""
    for (px, py), (qx, qy) in zip(window, window[1:] + window[:1], strict=True):
        sides = [(qx - px) * (y - py) - (qy - py) * (x - px) for x, y in subject]
        kept = []
        for i, (x, y) in enumerate(subject):
            before, now = sides[i - 1], sides[i]
            if (before > 0 > now) or (before < 0 < now):
                t = before / (before - now)
                kept.append((subject[i - 1][0] + t * (x - subject[i - 1][0]),
                             subject[i - 1][1] + t * (y - subject[i - 1][1])))  # fmt: skip
            if now >= 0:
                kept.append((x, y))
        subject = kept
    return subject


def shared_area(a: Sequence[float], b: Sequence[float], number: Any) -> float:
    polygon = clip(rectangle(a, number, a), rectangle(b, number, a))
    return float(
        sum(
            polygon[i - 1][0] * polygon[i][1] - polygon[i - 1][1] * polygon[i][0] for i in range(len(polygon))
        )
        / 2
    )
