"""LZF, the compression of `DATA binary_compressed` in PCD files (liblzf by Marc Lehmann)."""

from __future__ import annotations


def decompress(packed: bytes, size: int) -> bytes | None:
    """Return what was compressed, or None where that is not exactly `size` bytes long.

    Args:
        packed: Runs of up to 32 literal bytes, and references of 3 to 264 bytes to what was written before.
        size: Length of the result; more is never written.
    """
    out = bytearray()
    place, end = 0, len(packed)
    try:
        while place < end:
            control = packed[place]
            place += 1
            if control < 32:
                run = place + control + 1
                out += packed[place:run]
                place = run
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += packed[place]
                place += 1
            start = len(out) - ((control & 31) << 8) - packed[place] - 1
            place += 1
            if start < 0 or len(out) > size:
                return None
            part = out[start : start + length]
            while len(part) < length:  # it reaches into what it writes: a pattern that repeats
                part += part[: length - len(part)]
            out += part
    except IndexError:
        return None
    return bytes(out) if place == end and len(out) == size else None
