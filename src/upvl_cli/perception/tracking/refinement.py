"""What the frames of a track say together of its boxes: one size, a smooth path, a common score."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.types import Array, Floats, Ints

SMOOTH_S = (
    0.3  # frames so far apart count less by a factor of exp(-1/2): longer than noise, shorter than a turn
)
UNCONFIRMED = 0.5  # factor on the score of a box that no other frame confirms
LEAST = 1e-3  # lower scores weigh as much as this: boxes of no score have a mean too


def refined(seven: Floats, score: Floats, track: Ints, time_s: Floats) -> tuple[Floats, Floats]:
    """Boxes and scores, each corrected by the others of its track: hindsight, as labels have it.

    A size is the median of those of the track; feet stay where they were. Places lie on a line through those of
    the moments before and after, headings are the mean of those; scores are the geometric mean of a box's own
    and the track's mean. Boxes of a high score count more, by its square.

    Args:
        seven: (n, 7) boxes in axes that do not move.
        score: (n,) from 0 to 1.
        track: (n,) which boxes are one object; -1 for a box that is alone.
        time_s: (n,) when they were seen.
    """
    seven, score = seven.copy(), score * np.where(track < 0, UNCONFIRMED, 1.0)
    order = np.lexsort((time_s, track))
    ends = np.flatnonzero(np.diff(track[order], append=-2)) + 1
    for of in np.split(order, ends)[:-1]:
        if track[of[0]] >= 0:
            seven[of] = _together(seven[of], np.square(np.maximum(score[of], LEAST)), time_s[of])
            score[of] = np.sqrt(score[of] * score[of].mean())
    return seven, score


def _together(seven: Floats, weight: Floats, time_s: Floats) -> Floats:
    """The (n, 7) boxes of one track by falling weight of those around them."""
    size = np.array([_median(values, weight) for values in seven[:, 3:6].T])
    centre = seven[:, :3].copy()
    centre[:, 2] += (size[2] - seven[:, 5]) / 2
    late_s = time_s - time_s[:, None]  # (n, n): of each column after each row
    near = weight * np.exp(-np.square(late_s / SMOOTH_S) / 2)
    heading = _headings(seven[:, 6], near)
    return np.column_stack([_line(centre, near, late_s), np.tile(size, (len(seven), 1)), heading])


def _median(values: Array, weight: Array) -> float:
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(sums, sums[-1] / 2)])


def _line(places: Floats, near: Floats, late_s: Floats) -> Floats:
    """(n, 3) where the line of least squares through (n, 3) places, weighted by each row of `near`, is at its time."""
    first, second = (near * late_s).sum(axis=1), (near * np.square(late_s)).sum(axis=1)
    second += 1e-9 * near.sum(axis=1)  # a place alone is on its line
    part = near * (second[:, None] - first[:, None] * late_s)
    return np.asarray(part @ places / part.sum(axis=1, keepdims=True))


def _headings(heading: Floats, near: Floats) -> Floats:
    """(n,) mean headings: that of the axes first, as a box can look backwards, then the end that most look to."""
    axis = np.angle(near @ np.exp(2j * heading)) / 2
    ahead = (near * np.cos(heading - axis[:, None])).sum(axis=1) >= 0
    return wrap_angle(axis + np.where(ahead, 0.0, np.pi))
