"""Sweeps as bytes: the lengths in them that decoders trust, which end the process or fill the memory if damaged."""

from __future__ import annotations

import struct

import pyarrow as pa

from upvl_cli.datasets.py123d.library import library_errors
from upvl_cli.errors import BadInput

_ARROW, _LAZ, _DRACO = b"\xff\xff\xff\xff", b"LASF", b"DRACO"
_MAX_POINTS = 10_000_000  # of a sweep: the densest LiDARs measure half a million
_POINTS_PER_BYTE = 100  # no codec stores a measured point in less than a bit
_MAX_RECORDS = 100  # of a header; the library writes a few
_MAX_VARINT_BYTES = 10
_DRACO_HAS_METADATA = 0x8000


def check_stored_sweep(content: bytes, where: str) -> None:
    """Raise `BadInput` where a stored sweep says of itself that it is longer than it is.

    Args:
        content: The bytes, in one of the forms that the library knows.
        where: File and row, for the message.
    """
    if content.startswith(_ARROW):
        with library_errors(where), pa.ipc.open_stream(pa.py_buffer(content)) as stream:
            stream.read_next_batch().validate()
    elif content.startswith(_LAZ):
        _check_laz(content, where)
    elif content.startswith(_DRACO):
        _check_draco(content, where)


def _check_laz(content: bytes, where: str) -> None:
    """Check the header of a LAZ file (ASPRS LAS 1.4, LASzip): counts of points, of records and of chunks."""
    head = _Bytes(content, where)
    points, records = head.number("<I", 107), head.number("<I", 100)
    if head.number("<BB", 24) >= 4:
        points = max(points, head.number("<Q", 247))
        records = max(records, head.number("<I", 243))
    table = head.number("<q", head.number("<I", 96))
    if table == -1:  # the place of the table is at the end
        table = head.number("<q", len(content) - 8)
    head.check_points(points)
    head.check("records", records, _MAX_RECORDS)
    head.check("chunks", head.number("<I", table + 4), len(content))


def _check_draco(content: bytes, where: str) -> None:
    """Check the start of a Draco point cloud (bitstream 2.3): its metadata, and the count of points behind them."""
    head = _Bytes(content, where)
    head.place = 9  # behind magic, version, type and method
    if head.read("<H") & _DRACO_HAS_METADATA:
        attributes = head.varint()
        head.check("records", attributes, _MAX_RECORDS)
        for _ in range(attributes):
            head.varint()  # the number of the attribute
            _skip_draco_entries(head)
        _skip_draco_entries(head)
    head.check_points(head.read("<I"))


def _skip_draco_entries(head: _Bytes) -> None:
    entries = head.varint()
    head.check("records", entries, _MAX_RECORDS)
    for _ in range(entries):
        head.skip(head.read("<B"))  # the name
        head.skip(head.varint())  # the value
    head.check("nested records", head.varint(), 0)  # the library writes none


class _Bytes:
    """The bytes of a sweep, and where in them is read."""

    def __init__(self, content: bytes, where: str) -> None:
        self.content = content
        self.where = where
        self.place = 0

    def number(self, form: str, place: int) -> int:
        """Return the last number of a form at a place."""
        if not 0 <= place <= len(self.content) - struct.calcsize(form):
            raise BadInput(
                f"{self.where} is a sweep of {len(self.content)} bytes, expected more; convert the log again"
            )
        return int(struct.unpack_from(form, self.content, place)[-1])

    def read(self, form: str) -> int:
        """Return the number here, and go on behind it."""
        number = self.number(form, self.place)
        self.skip(struct.calcsize(form))
        return number

    def varint(self) -> int:
        """Return the number of 7 bits a byte here, the lowest first, and go on behind it."""
        number = 0
        for step in range(_MAX_VARINT_BYTES):
            byte = self.read("<B")
            number |= (byte & 0x7F) << 7 * step
            if byte < 0x80:
                break
        return number

    def skip(self, count: int) -> None:
        """Go on by so many bytes."""
        self.place += count

    def check_points(self, count: int) -> None:
        """Raise `BadInput` where there cannot be so many points."""
        self.check("points", count, min(_MAX_POINTS, _POINTS_PER_BYTE * len(self.content)))

    def check(self, name: str, count: int, limit: int) -> None:
        """Raise `BadInput` where a count is above its limit."""
        if count > limit:
            raise BadInput(
                f"{self.where} is a sweep with {count} {name} in {len(self.content)} bytes, expected at most "
                f"{limit}; convert the log again"
            )
