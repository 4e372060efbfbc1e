"""Where a histogram of two populations falls apart."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array


def minimum_error(counts: Array, edges: Array) -> float:
    """The threshold of least error between two normal populations, of any share of the whole.

    Kittler and Illingworth, "Minimum error thresholding", Pattern Recognition 1986. Background is most of a
    street: Otsu's threshold, which takes both for equally large, lies inside of it.

    Args:
        counts: (b,) how many values lie in each bin.
        edges: (b + 1,) bounds of the bins, ascending.
    """
    share = counts / counts.sum()
    middle = (edges[1:] + edges[:-1]) / 2
    width = edges[1] - edges[0]
    best, at = np.inf, float(middle.mean())
    for cut in range(1, len(share)):
        cost = 0.0
        for part, places in ((share[:cut], middle[:cut]), (share[cut:], middle[cut:])):
            weight = part.sum()
            if weight < 1e-3:  # a population of next to nothing is none
                cost = np.inf
                break
            mean = (part * places).sum() / weight
            # A bin has a width: a population in one bin is not infinitely sharp.
            variance = (part * (places - mean) ** 2).sum() / weight + width**2 / 12
            cost += weight * (np.log(variance) / 2 - np.log(weight))
        if cost < best:
            best, at = cost, float(edges[cut])
    return at
