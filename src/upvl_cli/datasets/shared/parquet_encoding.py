"""How Parquet writes the levels of a page, and a file around a single page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.shared.thrift import Long, read_varint, write_struct
from upvl_cli.types import Array, Ints


def single_column_file(pages: list[bytes], kind: int, count: int) -> bytes:
    """Return a Parquet file of one required column, which pyarrow decodes.

    Args:
        pages: Headers and contents of a dictionary page, if there is one, and of a data page.
        kind: Parquet's number of the type of its values.
        count: How many values the data page holds.
    """
    body = b"".join(pages)
    offsets = {9: Long(4 + len(pages[0])), 11: Long(4)} if len(pages) == 2 else {9: Long(4)}
    size = Long(len(body))
    column = {1: kind, 2: [0], 3: [b"x"], 4: 0, 5: Long(count), 6: size, 7: size, **offsets}
    schema = [{3: 0, 4: b"schema", 5: 1}, {1: kind, 3: 0, 4: b"x"}]
    group = {1: [{2: Long(4), 3: column}], 2: size, 3: Long(count)}
    footer = write_struct({1: 1, 2: schema, 3: Long(count), 4: [group]})
    return b"".join([b"PAR1", body, footer, len(footer).to_bytes(4, "little"), b"PAR1"])


@dataclass(frozen=True)
class LevelRuns:
    """Levels of the entries of a page, as runs of equal ones."""

    levels: Array
    lengths: Array

    def all_equal(self, level: int) -> bool:
        """Return whether every level is this one."""
        return bool((self.levels == level).all())

    def positions(self, level: int) -> Ints:
        """Return the entries of this level, ascending."""
        starts = np.cumsum(self.lengths) - self.lengths
        of_level = self.levels == level
        lengths = self.lengths[of_level]
        inside = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        return np.asarray(np.repeat(starts[of_level], lengths) + inside)

    def expanded(self) -> Array:
        """Return the level of each entry."""
        return np.repeat(self.levels, self.lengths)


def read_levels(content: memoryview, bit_width: int, count: int) -> LevelRuns:
    """Return levels from Parquet's hybrid of runs and packed bits.

    Args:
        content: The encoded levels.
        bit_width: Bits of each.
        count: How many they are.

    Raises:
        ValueError: The bytes end too early.
    """
    levels, lengths = [np.zeros(0, np.uint8)], [np.zeros(0, np.int64)]
    found = position = 0
    while found < count:
        try:
            head, position = read_varint(content, position)
        except IndexError:
            raise ValueError("the levels end too early") from None
        length = min(head >> 1, count)
        if head & 1:
            stop = position + length * bit_width
            values = _unpack(content[position:stop], bit_width)[: count - found]
            levels.append(values)
            lengths.append(np.ones(len(values), np.int64))
            length, position = len(values), stop
        else:
            length = min(length, count - found)
            levels.append(np.frombuffer(content[position : position + 1], np.uint8))
            lengths.append(np.array([length]))
            position += 1
        if not length or not len(levels[-1]):
            raise ValueError("the levels end too early")
        found += length
    return LevelRuns(np.concatenate(levels), np.concatenate(lengths))


def _unpack(content: memoryview, bit_width: int) -> Array:
    bits = np.unpackbits(np.frombuffer(content, np.uint8), bitorder="little")
    numbers = bits[: len(bits) // bit_width * bit_width].reshape(-1, bit_width)
    return np.asarray((numbers << np.arange(bit_width, dtype=np.uint8)).sum(axis=1, dtype=np.uint8))
