"""Which frames a step learns from: all of them in a new order each time round, known from seed and step alone."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from upvl_cli.types import Ints

# Each purpose has random numbers of its own, so that no draw changes another.
_ORDER, _CHANCE = 0, 1


def items(step: int, batch: int, frames: int, seed: int) -> list[int]:
    """Return the frames of a step.

    Args:
        step: Which, from 0 on.
        batch: How many frames a step has.
        frames: How many there are.
        seed: Of the order.
    """
    first = step * batch
    return [
        int(_order(number // frames, frames, seed)[number % frames]) for number in range(first, first + batch)
    ]


def chance(step: int, place: int, seed: int) -> np.random.Generator:
    """Return the random numbers of one place of the batch of a step."""
    return np.random.default_rng([seed, _CHANCE, step, place])


@lru_cache(maxsize=2)
def _order(turn: int, frames: int, seed: int) -> Ints:
    return np.random.default_rng([seed, _ORDER, turn]).permutation(frames)
