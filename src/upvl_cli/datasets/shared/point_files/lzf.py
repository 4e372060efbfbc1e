"""LZF, the compression of `DATA binary_compressed` in PCD files (liblzf by Marc Lehmann)."""

from __future__ import annotations


def decompress(packed: bytes, size: int) -> bytes | None:
    """Return what was compressed, or None where that is not exactly `size` bytes long.

    A sweep has some 500 000 runs: this loop is kept to few steps each.

    Args:
        packed: Runs of up to 32 literal bytes, and references of 3 to 264 bytes to what was written before.
        size: Length of the result; no more than one run is written beyond.
    """
    out = bytearray()
    place, filled, end = 0, 0, len(packed)
    try:
        while place < end:
            control = packed[place]
            if control < 32:
                run = place + control + 2
                out += packed[place + 1 : run]
                filled += control + 1
                place = run
                continue
            if control < 224:
                length = (control >> 5) + 2
                distance = ((control & 31) << 8) + packed[place + 1] + 1
                place += 2
            else:
                length = packed[place + 1] + 9
                distance = ((control & 31) << 8) + packed[place + 2] + 1
                place += 3
            start = filled - distance
            if start < 0 or filled > size:
                return None
            if distance >= length:
                out += out[start : start + length]
            else:  # it reaches into what it writes: a pattern that repeats
                out += (out[start:] * (length // distance + 1))[:length]
            filled += length
    except IndexError:
        return None
    return bytes(out) if place == end and len(out) == filled == size else None
