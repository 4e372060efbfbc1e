"""The threshold that separates the two populations of a histogram."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array

_MIN_WEIGHT = 1e-3  # a population of next to no values has no variance


def minimum_error_threshold(counts: Array, edges: Array) -> float:
    """Return the threshold of least classification error between two normal populations of any share.

    Kittler and Illingworth, "Minimum error thresholding", Pattern Recognition 1986, equation 15. Background is most
    of a street: Otsu's threshold, which takes both populations as equally large, lies inside of it.

    Args:
        counts: (b,) number of values in each bin.
        edges: (b + 1,) bounds of the bins, evenly spaced and ascending.
    """
    share = counts / counts.sum()
    center = (edges[1:] + edges[:-1]) / 2
    width = edges[1] - edges[0]
    least, threshold = np.inf, float(center.mean())
    for cut in range(1, len(share)):
        cost = 0.0
        for part, values in ((share[:cut], center[:cut]), (share[cut:], center[cut:])):
            weight = part.sum()
            if weight < _MIN_WEIGHT:
                cost = np.inf
                break
            mean = (part * values).sum() / weight
            # A bin has a width: a population in one bin is not infinitely sharp.
            variance = (part * (values - mean) ** 2).sum() / weight + width**2 / 12
            cost += weight * (np.log(variance) / 2 - np.log(weight))
        if cost < least:
            least, threshold = cost, float(edges[cut])
    return threshold
