"""Order of training frames: all of them in a new order each epoch, which follows from the seed alone."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from upvl_cli.types import Ints

# Each purpose has random numbers of its own, so that no draw changes another.
_ORDER, _CHANGES = 0, 1


def frame_at(index: int, frames: int, seed: int) -> int:
    """Return the frame at an index of the endless order.

    Args:
        index: From 0 on; a step of b frames takes b of them.
        frames: How many frames there are.
        seed: Seed of the order.
    """
    return int(_order(index // frames, frames, seed)[index % frames])


def generator_at(index: int, seed: int) -> np.random.Generator:
    """Return the random numbers for the changes at one index of the order."""
    return np.random.default_rng([seed, _CHANGES, index])


@lru_cache(maxsize=4)
def _order(epoch: int, frames: int, seed: int) -> Ints:
    return np.random.default_rng([seed, _ORDER, epoch]).permutation(frames)
