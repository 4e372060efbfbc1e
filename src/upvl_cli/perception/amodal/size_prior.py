"""Whole size of an object by what was seen of it, and by the sizes that road users have.

What was seen of a side is either all of it, short by little, or some part of it. Which of both, and how long the
side then is, follows from Bayes' rule over the kinds of road users: a thing 1.8 m wide and 1.5 m high of which only
the end was seen is a car, some 4.5 m long. What fits no kind keeps the size that was seen.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.perception.amodal.config import SizePriorConfig
from upvl_cli.types import Array, Bools, Floats

_STEPS = 61  # of a size between the ends of its distribution: 0.1 standard deviations
_FLAT = np.array([1.0, 1.0, 0.0])  # length and width; a roof is flat, and its height is seen in full
_REACH = 3.0  # standard deviations from the mean to its ends


def whole_size(seen_m: Floats, is_shown: Bools, speed_mps: float, config: SizePriorConfig) -> Array:
    """Return (3,) expected length, width and height, never below what was seen.

    Args:
        seen_m: (3,) extents of all that was seen.
        is_shown: (3,) whether the sensor saw the object from where the whole extent shows.
        speed_mps: The highest speed of the object.
        config: The kinds and the errors of an extent.
    """
    shown_share = np.array([config.whole_share_shown, config.whole_share_shown, config.whole_height_share])
    share = np.where(is_shown, shown_share, config.whole_share_hidden)
    weights, expected = [], []
    for kind in config.kinds:
        too_fast = kind.max_speed_mps > 0 and speed_mps > kind.max_speed_mps
        likelihood, size_m = _extents(
            seen_m, share, np.array(kind.mean_lwh_m), np.array(kind.spread_lwh_m), config
        )
        weights.append(0.0 if too_fast else kind.share * likelihood.prod())
        expected.append(size_m)
    weights.append(config.other_share / config.other_volume_m3)
    expected.append(seen_m)
    return np.asarray(np.maximum(np.average(expected, axis=0, weights=weights), seen_m))


def _extents(
    seen_m: Floats, whole_share: Floats, mean_m: Floats, spread_m: Floats, config: SizePriorConfig
) -> tuple[Array, Array]:
    """Return (3,) densities of extents under a kind of normally distributed size, and the (3,) expected sizes.

    Args:
        seen_m: (3,) extents that were seen.
        whole_share: (3,) how likely each is the whole one.
        mean_m: (3,) mean size of the kind.
        spread_m: (3,) standard deviation.
        config: The errors of an extent.
    """
    step = np.linspace(-_REACH, _REACH, _STEPS)[:, None]
    size_m = np.maximum(mean_m + step * spread_m, mean_m / 10)
    prior = np.exp(-0.5 * step**2)
    prior = prior / prior.sum()
    error_m = config.extent_error_m + config.extent_error_share * size_m
    off = (seen_m - (1 - config.shortfall_share * _FLAT) * size_m) / error_m
    complete = np.exp(-0.5 * off**2) / (np.sqrt(2 * np.pi) * error_m)
    # Of a part all extents up to the size are equally likely; its end is as blurred as a whole extent.
    part = 1 / (size_m * (1 + np.exp(np.minimum((seen_m - size_m) / (error_m / 2), 50))))
    density = prior * (whole_share * complete + (1 - whole_share) * part)
    likelihood = density.sum(axis=0)
    return likelihood, (density * size_m).sum(axis=0) / np.maximum(likelihood, np.finfo(float).tiny)
