"""TFRecord files: where each record lies and, in it, each field of its message. No content is read for that."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from upvl_cli.datasets.shared import folders
from upvl_cli.datasets.shared.content import unreadable
from upvl_cli.datasets.shared.thrift import read_varint
from upvl_cli.datasets.waymo.wire import BYTES, FIXED32, FIXED64, VARINT
from upvl_cli.errors import BadInput

_HEADER_BYTES = 12  # the length of the record, and its checksum
_FOOTER_BYTES = 4  # the checksum of the record
_WINDOW_BYTES = 8192
_VARINT_BYTES = 10
_MAX_RECORDS = 100_000


@dataclass(frozen=True)
class Record:
    """One record, which is one message.

    Attributes:
        path: The file.
        number: Of the record in the file.
        fields: Offset and length of the content of each field of bytes, by field number.
        numbers: Values of the fields of whole numbers, by field number.
    """

    path: Path
    number: int
    fields: dict[int, list[tuple[int, int]]]
    numbers: dict[int, int]

    @property
    def where(self) -> str:
        """File and record, for messages."""
        return f"{self.path}, record {self.number}"

    def read(self, field: int) -> list[bytes]:
        """Return the content of each field of that number.

        Args:
            field: Number of the field.
        """
        spans = self.fields.get(field, [])
        if not spans:
            return []
        with open_file(self.path) as file:
            return [self._read(file, offset, length) for offset, length in spans]

    def heads(self, field: int, count: int) -> list[bytes]:
        """Return the first `count` bytes of the content of each field of that number."""
        with open_file(self.path) as file:
            return [
                self._read(file, offset, min(count, length)) for offset, length in self.fields.get(field, [])
            ]

    def read_one(self, field: int, index: int) -> bytes:
        """Return the content of one field of that number.

        Args:
            field: Number of the field.
            index: Which of them.
        """
        with open_file(self.path) as file:
            return self._read(file, *self.fields[field][index])

    def _read(self, file: IO[bytes], offset: int, length: int) -> bytes:
        content = read_at(file, offset, length)
        if len(content) != length:
            raise BadInput(f"{self.where} is cut off; copy the file again")
        return content


def open_file(path: Path) -> IO[bytes]:
    """Return a file opened to read; raises `BadInput` where the system does not let us."""
    try:
        return path.open("rb", buffering=0)
    except OSError as error:
        raise unreadable(path, error) from None


def read_at(file: IO[bytes], offset: int, length: int) -> bytes:
    """Return bytes of a file, fewer where it ends before; raises `BadInput` where it cannot be read."""
    try:
        return folders.read_at(file, offset, length)
    except OSError as error:
        raise unreadable(Path(str(file.name)), error) from None


def read_records(path: Path) -> Iterator[Record]:
    """Yield the records of a file.

    Args:
        path: The file.

    Raises:
        BadInput: It is no TFRecord file, or cut off.
    """
    with open_file(path) as file:
        size = file.seek(0, os.SEEK_END)
        offset = number = 0
        while offset < size and number < _MAX_RECORDS:
            header = read_at(file, offset, _HEADER_BYTES)
            length = int.from_bytes(header[:8], "little")
            if len(header) < _HEADER_BYTES or masked_crc32c(header[:8]) != int.from_bytes(
                header[8:], "little"
            ):
                raise BadInput(f"{path}: no TFRecord begins at byte {offset}; copy the file again")
            start = offset + _HEADER_BYTES
            if length > size - start - _FOOTER_BYTES:
                raise BadInput(
                    f"{path}: record {number} has {length} bytes, but the file ends after {size - start}; it is cut "
                    "off: copy it again"
                )
            yield _record(file, path, number, start, start + length)
            offset = start + length + _FOOTER_BYTES
            number += 1


def _record(file: IO[bytes], path: Path, number: int, start: int, stop: int) -> Record:
    record = Record(path, number, {}, {})
    damage = BadInput(f"{record.where} is damaged (it is no message); copy the file again")
    window, begin = b"", start
    position = start
    while position < stop:
        if position < begin or position + 2 * _VARINT_BYTES > begin + len(window):
            begin, window = position, read_at(file, position, min(_WINDOW_BYTES, stop - position))
        try:
            key, at = read_varint(window, position - begin)
            field, wire = key >> 3, key & 7
            if wire == VARINT:
                record.numbers[field], at = read_varint(window, at)
                length = 0
            elif wire == BYTES:
                length, at = read_varint(window, at)
            else:
                length = {FIXED64: 8, FIXED32: 4}[wire]
        except (IndexError, KeyError, ValueError):
            raise damage from None
        position = begin + at
        if field == 0 or length > stop - position:
            raise damage
        if wire == BYTES:
            record.fields.setdefault(field, []).append((position, length))
        position += length
    return record


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
        table.append(crc)
    return tuple(table)


_CRC_TABLE = _crc_table()


def masked_crc32c(content: bytes) -> int:
    """Return TFRecord's checksum of a few bytes: CRC-32C, rotated by 15 bits, plus a constant.

    Args:
        content: The bytes; the content of a record is too long for it.
    """
    crc = 0xFFFFFFFF
    for byte in content:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 255]
    crc ^= 0xFFFFFFFF
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF
