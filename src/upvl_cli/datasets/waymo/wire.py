"""Messages of Protocol Buffers, read without their schema compiled: fields by number."""

from __future__ import annotations

import struct

import numpy as np

from upvl_cli.datasets.shared.thrift import read_varint
from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Ints

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5


class Message:
    """The fields of one message. What is missing has the default of proto2: 0, or nothing."""

    def __init__(self, content: bytes | memoryview, where: str) -> None:
        """Find the fields.

        Args:
            content: The encoded message.
            where: File and message, for messages.

        Raises:
            BadInput: It is no message.
        """
        self.where = where
        self._fields: dict[int, list[tuple[int, int | memoryview]]] = {}
        try:
            self._read(memoryview(content))
        except (IndexError, ValueError):
            raise self.damage("it is no whole message") from None

    def _read(self, content: memoryview) -> None:
        position = 0
        while position < len(content):
            key, position = read_varint(content, position)
            number, wire = key >> 3, key & 7
            value: int | memoryview
            if wire == VARINT:
                value, position = read_varint(content, position)
            else:
                if wire == BYTES:
                    length, position = read_varint(content, position)
                else:
                    length = {FIXED64: 8, FIXED32: 4}.get(wire, -1)
                if number == 0 or not 0 <= length <= len(content) - position:
                    raise ValueError(f"field {number} of kind {wire} has {length} bytes")
                value = content[position : position + length]
                position += length
            self._fields.setdefault(number, []).append((wire, value))

    def damage(self, what: str) -> BadInput:
        """Return the error for a damaged message."""
        return BadInput(f"{self.where} is damaged ({what}); copy the file again")

    def __contains__(self, number: int) -> bool:
        return number in self._fields

    def _values(self, number: int, wire: int) -> list[int | memoryview]:
        found = self._fields.get(number, [])
        if any(kind != wire for kind, _ in found):
            raise self.damage(f"field {number} is of another type")
        return [value for _, value in found]

    def number(self, number: int) -> int:
        """Return a whole number, the last where there are several."""
        values = self._values(number, VARINT)
        value = values[-1] if values else 0
        assert isinstance(value, int)
        return value - (1 << 64) if value >> 63 else value

    def whole_numbers(self, number: int) -> list[int]:
        """Return the whole numbers of a repeated field, packed or not."""
        found = []
        for wire, value in self._fields.get(number, []):
            if isinstance(value, int):
                found.append(value)
            elif wire == BYTES:
                try:
                    position = 0
                    while position < len(value):
                        item, position = read_varint(value, position)
                        found.append(item)
                except (IndexError, ValueError):
                    raise self.damage(f"field {number} is cut off") from None
        return found

    def double(self, number: int) -> float:
        """Return a number of 64 bits, the last where there are several."""
        values = self._values(number, FIXED64)
        return float(struct.unpack("<d", values[-1])[0]) if values else 0.0  # type: ignore[arg-type]

    def single(self, number: int) -> float:
        """Return a number of 32 bits, the last where there are several."""
        values = self._values(number, FIXED32)
        return float(struct.unpack("<f", values[-1])[0]) if values else 0.0  # type: ignore[arg-type]

    def doubles(self, number: int) -> Array:
        """Return the numbers of 64 bits of a repeated field, packed or not."""
        parts = []
        for wire, value in self._fields.get(number, []):
            if wire not in (FIXED64, BYTES) or len(value) % 8:  # type: ignore[arg-type]
                raise self.damage(f"field {number} is of another type")
            parts.append(np.frombuffer(value, "<f8"))  # type: ignore[arg-type]
        return np.concatenate([*parts, np.zeros(0)])

    def blocks(self, number: int) -> list[memoryview]:
        """Return the bytes of each message, text or packed field of that number."""
        return [value for value in self._values(number, BYTES) if isinstance(value, memoryview)]

    def block(self, number: int) -> memoryview:
        """Return the last of `blocks`, empty where there is none."""
        found = self.blocks(number)
        return found[-1] if found else memoryview(b"")

    def message(self, number: int) -> Message:
        """Return the message in a field, one without fields where it is missing."""
        return Message(self.block(number), self.where)

    def messages(self, number: int) -> list[Message]:
        """Return the messages of a repeated field."""
        return [Message(block, self.where) for block in self.blocks(number)]

    def text(self, number: int) -> str:
        """Return a text."""
        try:
            return str(self.block(number), "utf-8")
        except UnicodeDecodeError:
            raise self.damage(f"field {number} is no text") from None

    def transform(self, number: int) -> Array:
        """Return the (4, 4) of a message that holds its 16 numbers in field 1."""
        values = self.message(number).doubles(1)
        if len(values) != 16:
            raise self.damage(f"field {number} is a transform of {len(values)} numbers, expected 16")
        return values.reshape(4, 4)


def unpack_varints(content: memoryview | bytes) -> Ints:
    """Return packed whole numbers from 0 to below 2**21, as int32.

    Raises:
        ValueError: The last one is not whole, or one is larger.
    """
    encoded = np.frombuffer(content, np.uint8)
    ends = np.flatnonzero(encoded < 128)
    if len(encoded) and (not len(ends) or ends[-1] != len(encoded) - 1):
        raise ValueError("the last number is cut off")
    values = encoded[ends].astype(np.int32)
    extra = np.diff(ends, prepend=-1) - 1
    if extra.max(initial=0) > 2:
        raise ValueError("a number is too large")
    for count in (1, 2):
        longer = np.flatnonzero(extra >= count)
        values[longer] = values[longer] << 7 | (encoded[ends[longer] - count] & 127)
    return values
