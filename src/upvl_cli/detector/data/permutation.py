"""A pseudo-random permutation of many numbers, computed one number at a time, without a list of them."""

from __future__ import annotations

from collections.abc import Sequence

_64_BITS = 2**64 - 1


def permuted(index: int, size: int, keys: Sequence[int]) -> int:
    """Return where a permutation of 0, ..., size - 1 takes a number.

    A Feistel network permutes the numbers of an even number of bits, at most 4 `size` of them; what it takes to a
    number that is too large is permuted again (cycle walking; Black and Rogaway, CT-RSA 2002).

    Args:
        index: From 0 to size - 1.
        size: How many numbers there are.
        keys: One random number of 64 bits a round; other keys give another permutation.
    """
    half = max((size - 1).bit_length() + 1, 2) // 2
    low = (1 << half) - 1
    while True:
        left, right = index >> half, index & low
        for key in keys:
            left, right = right, left ^ (_mix(right ^ key) & low)
        index = left << half | right
        if index < size:
            return index


def _mix(bits: int) -> int:
    """Return 64 bits each of which depends on all of those given (the finalizer of SplitMix64, OOPSLA 2014)."""
    bits = ((bits ^ bits >> 30) * 0xBF58476D1CE4E5B9) & _64_BITS
    bits = ((bits ^ bits >> 27) * 0x94D049BB133111EB) & _64_BITS
    return bits ^ bits >> 31
