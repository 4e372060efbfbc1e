"""Messages of Protocol Buffers, written without their schema compiled: fields by number.

The encoding: protobuf.dev/programming-guides/encoding.
"""

from __future__ import annotations

import struct

from upvl_cli.datasets.shared.thrift import write_varint
from upvl_cli.datasets.waymo.wire import BYTES, FIXED32, FIXED64, VARINT

_WORD = 1 << 64


def whole_number(number: int, value: int) -> bytes:
    """Return a field of a whole number or a choice."""
    return _key(number, VARINT) + write_varint(value % _WORD)


def double(number: int, value: float) -> bytes:
    """Return a field of a number of 64 bits."""
    return _key(number, FIXED64) + struct.pack("<d", value)


def single(number: int, value: float) -> bytes:
    """Return a field of a number of 32 bits."""
    return _key(number, FIXED32) + struct.pack("<f", value)


def text(number: int, value: str) -> bytes:
    """Return a field of text."""
    return message(number, value.encode())


def message(number: int, content: bytes) -> bytes:
    """Return a field that holds a message, or bytes."""
    return _key(number, BYTES) + write_varint(len(content)) + content


def _key(number: int, kind: int) -> bytes:
    return write_varint(number << 3 | kind)
