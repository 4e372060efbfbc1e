"""Which frames a step learns from: all of them in a new order each time round, known from the seed alone."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from upvl_cli.types import Ints

# Each purpose has random numbers of its own, so that no draw changes another.
_ORDER, _CHANCE = 0, 1


def item(at: int, frames: int, seed: int) -> int:
    """Return the frame at a place of the endless order.

    Args:
        at: Which place, from 0 on; a step of b frames takes b places.
        frames: How many frames there are.
        seed: Of the order.
    """
    return int(_order(at // frames, frames, seed)[at % frames])


def chance(at: int, seed: int) -> np.random.Generator:
    """Return the random numbers of one place of the order."""
    return np.random.default_rng([seed, _CHANCE, at])


@lru_cache(maxsize=4)
def _order(turn: int, frames: int, seed: int) -> Ints:
    return np.random.default_rng([seed, _ORDER, turn]).permutation(frames)
