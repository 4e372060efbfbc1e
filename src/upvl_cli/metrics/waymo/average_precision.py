"""Area under a precision-recall curve of few points, in the float32 steps of the official tool.

Source: waymo-open-dataset 99a4cb3, metrics/metrics_utils.cc, ComputeMeanAveragePrecision.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Floats

_RECALL_STEP = np.float32(0.05)
_MAX_GAP = _RECALL_STEP + np.float32(1e-6)


def average_precision(precision: Floats, recall: Floats) -> float:
    """Return the area under the curve; wide gaps in recall get the precision of their far side.

    Args:
        precision: (c,) float32 precision at each cut-off.
        recall: (c,) float32 recall at each cut-off, in any order.
    """
    curve = _fill_gaps(precision, recall)
    area = np.float32(0.0)
    for (p_before, r_before), (p, r) in zip(curve, curve[1:], strict=False):
        area = np.float32(float(area) + 0.5 * float(r_before - r) * float(p_before + p))
    return min(float(area), 1.0)  # the steps add up to 1.00000012 for a perfect detector


def _fill_gaps(precision: Floats, recall: Floats) -> list[tuple[np.float32, np.float32]]:
    """Return (precision, recall) from high to low recall, precision rising, gaps filled."""
    best = {np.float32(0.0): np.float32(1.0)}
    for p, r in zip(precision.astype(np.float32), recall.astype(np.float32), strict=True):
        best[r] = max(best.get(r, p), p)
    curve: list[tuple[np.float32, np.float32]] = []
    highest, last = np.float32(0.0), np.float32(0.0)
    for r in sorted(best, reverse=True):
        while last - r > _MAX_GAP:
            last -= _RECALL_STEP
            curve.append((highest, last))
        highest = max(highest, best[r])
        curve.append((highest, r))
        last = r
    if len(curve) > 1:  # the point at recall 0 was made up above: it takes its neighbour's precision
        curve[-1] = (curve[-2][0], curve[-1][1])
    return curve
