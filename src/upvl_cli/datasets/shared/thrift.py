"""The compact protocol of Thrift, as far as Parquet's page headers and footers use it."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

_MOST_DEPTH = 8  # a page header nests three structures
_TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _STRUCT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 12

Fields = dict[int, "int | float | bytes | bool | Fields"]


class Long(int):
    """A number that is written as i64; other numbers are i32."""


class ShortInput(ValueError):
    """The bytes end before the structure does."""


def read_struct(content: bytes, position: int, depth: int = 0) -> tuple[Fields, int]:
    """Return the fields of a structure by number, and the position after it.

    Args:
        content: Bytes that hold the structure.
        position: Where it begins.
        depth: How many structures it lies in.

    Raises:
        ShortInput: The bytes end too early.
        ValueError: They are no such structure.
    """
    if depth > _MOST_DEPTH:
        raise ValueError("structures nest too deep")
    fields: Fields = {}
    number = 0
    try:
        while True:
            byte = content[position]
            position += 1
            if byte == 0:
                return fields, position
            kind = byte & 15
            if byte >> 4:
                number += byte >> 4
            else:
                number, position = _signed(content, position)
            if kind in (_I32, _I64, _I16):
                fields[number], position = _signed(content, position)
            else:
                fields[number], position = _read_value(content, position, kind, depth)
    except (IndexError, struct.error):
        raise ShortInput("a structure ends too early") from None


def _read_value(content: bytes, position: int, kind: int, depth: int) -> tuple[Any, int]:
    """Return a value that is no number of a varying length, and the position after it."""
    if kind in (_TRUE, _FALSE):
        return kind == _TRUE, position
    if kind == _STRUCT:
        return read_struct(content, position, depth + 1)
    if kind == _BYTE:
        return content[position], position + 1
    if kind == _DOUBLE:
        return struct.unpack_from("<d", content, position)[0], position + 8
    if kind != _BINARY:
        raise ValueError(f"a field has the kind {kind}")
    length, position = read_varint(content, position)
    if position + length > len(content):
        raise ShortInput("a text ends too early")
    return content[position : position + length], position + length


def read_varint(content: bytes | memoryview, position: int) -> tuple[int, int]:
    """Return a number of 7 bits a byte, and the position after it.

    Raises:
        IndexError: The bytes end too early.
        ValueError: The number has more than 64 bits.
    """
    byte = content[position]
    if byte < 128:
        return byte, position + 1
    value, shift = 0, 0
    while True:
        byte = content[position]
        position += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, position
        shift += 7
        if shift > 63:
            raise ValueError("a number has more than 64 bits")


def _signed(content: bytes, position: int) -> tuple[int, int]:
    value, position = read_varint(content, position)
    return (value >> 1) ^ -(value & 1), position


def write_struct(fields: Mapping[int, object]) -> bytes:
    """Return a structure of numbers, texts (bytes), structures (mapping) and lists of one kind of them.

    Args:
        fields: Values by ascending field number.
    """
    out = bytearray()
    last = 0
    for number, value in fields.items():
        out.append((number - last) << 4 | _kind(value))
        out += _content(value)
        last = number
    out.append(0)
    return bytes(out)


def _kind(value: object) -> int:
    if isinstance(value, int):
        return _I64 if isinstance(value, Long) else _I32
    if isinstance(value, bytes):
        return _BINARY
    return _STRUCT if isinstance(value, Mapping) else _LIST


def _content(value: object) -> bytes:
    if isinstance(value, int):
        return write_varint(value << 1 if value >= 0 else (-value << 1) - 1)
    if isinstance(value, bytes):
        return write_varint(len(value)) + value
    if isinstance(value, Mapping):
        return write_struct(value)
    assert isinstance(value, Sequence) and len(value) < 15
    head = bytes([len(value) << 4 | _kind(value[0])])
    return head + b"".join(_content(item) for item in value)


def write_varint(value: int) -> bytes:
    """Return a number of 0 or more in groups of seven bits, the lowest first, as Thrift and protobuf have it."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)
