"""Smoothing of the boxes of a track: one size, a smooth path, a common score."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.perception.tracking.config import SmoothingConfig
from upvl_cli.types import Array, Boxes, Floats, Ints

# Of a track of more boxes than a block only those around a block are weighed: others have less than 1e-13 of the
# weight. So memory and time do not grow with the square of the track.
_BLOCK = 500
_REACH = 8.0  # standard deviations
_RIDGE = 1e-9  # share of the weight that keeps the line through a single center defined


def smooth_tracks(
    boxes: Boxes, score: Floats, track_id: Ints, time_s: Floats, config: SmoothingConfig
) -> tuple[Boxes, Floats]:
    """Return boxes and scores, each corrected by the other boxes of its track, before and after it.

    The size is the weighted median of the track; the lower side of a box stays where it was. Centers are local
    linear regressions in time (Cleveland, Robust locally weighted regression, 1979) with a Gaussian weight, and
    headings the mean under that weight; scores are the geometric mean of a box's own score and the track's mean.
    A box is weighted with the square of its score.

    Args:
        boxes: n boxes in axes that do not move.
        score: (n,) from 0 to 1.
        track_id: (n,) the track of each box; -1 for a box that is in none.
        time_s: (n,) time of each box.
        config: Settings.
    """
    score = score * np.where(track_id < 0, config.unconfirmed_score_factor, 1.0)
    center_m, size_lwh_m = boxes.center_m.copy(), boxes.size_lwh_m.copy()
    heading_rad = boxes.heading_rad.copy()
    order = np.lexsort((time_s, track_id))
    ends = np.flatnonzero(np.diff(track_id[order], append=-2)) + 1
    for rows in np.split(order, ends)[:-1]:
        if track_id[rows[0]] >= 0:
            weight = np.square(np.maximum(score[rows], config.min_weight_score))
            smooth = _smooth(boxes[rows], weight, time_s[rows], config.window_s)
            center_m[rows], size_lwh_m[rows] = smooth.center_m, smooth.size_lwh_m
            heading_rad[rows] = smooth.heading_rad
            score[rows] = np.sqrt(score[rows] * score[rows].mean())
    return Boxes(center_m, size_lwh_m, heading_rad), score


def _smooth(boxes: Boxes, weight: Floats, time_s: Floats, window_s: float) -> Boxes:
    """Return the boxes of one track."""
    size_lwh_m = np.array([weighted_median(values, weight) for values in boxes.size_lwh_m.T])
    center_m = boxes.center_m.copy()
    center_m[:, 2] += (size_lwh_m[2] - boxes.size_lwh_m[:, 2]) / 2
    path_m, heading_rad = [], []
    for first in range(0, len(time_s), _BLOCK):
        here_s = time_s[first : first + _BLOCK]
        near = slice(0, len(time_s))
        if len(time_s) > _BLOCK:
            reach_s = _REACH * window_s
            near = slice(*np.searchsorted(time_s, [here_s[0] - reach_s, here_s[-1] + reach_s]))
        later_s = time_s[near] - here_s[:, None]  # (n, m): of each column after each row
        kernel = weight[near] * np.exp(-np.square(later_s / window_s) / 2)
        heading_rad.append(_mean_headings(boxes.heading_rad[near], kernel))
        path_m.append(_local_lines(center_m[near], kernel, later_s))
    size_lwh_m = np.tile(size_lwh_m, (len(boxes), 1))
    return Boxes(np.concatenate(path_m), size_lwh_m, np.concatenate(heading_rad))


def weighted_median(values: Array, weight: Array) -> float:
    """Return the lowest value such that it and those below it have half of the weight.

    Args:
        values: (n,) values, n > 0.
        weight: (n,) positive weights.
    """
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(sums, sums[-1] / 2)])


def _local_lines(center_m: Floats, kernel: Floats, later_s: Floats) -> Floats:
    """Return (n, 3) values at time 0 of the least squares lines through the centers, one for each row of weights."""
    first, second = (kernel * later_s).sum(axis=1), (kernel * np.square(later_s)).sum(axis=1)
    second += _RIDGE * kernel.sum(axis=1)
    share = kernel * (second[:, None] - first[:, None] * later_s)
    return np.asarray(_sums(share, center_m) / share.sum(axis=1, keepdims=True))


def _mean_headings(heading_rad: Floats, kernel: Floats) -> Floats:
    """Return (n,) mean headings: that of the axes first, as a box can look backwards, then the end of most weight."""
    doubled = np.column_stack([np.cos(2 * heading_rad), np.sin(2 * heading_rad)])
    cos, sin = _sums(kernel, doubled).T
    axis_rad = np.arctan2(sin, cos) / 2
    is_ahead = (kernel * np.cos(heading_rad - axis_rad[:, None])).sum(axis=1) >= 0
    return wrap_angle(axis_rad + np.where(is_ahead, 0.0, np.pi))


def _sums(weight: Floats, values: Floats) -> Array:
    """Return (n, d) sums of (m, d) values under each row of (n, m) weights, in an order that no processor changes."""
    return np.stack([(weight * column).sum(axis=1) for column in values.T], axis=1)
