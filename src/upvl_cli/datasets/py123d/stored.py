"""Sweeps as bytes: the lengths in them that decoders trust, which end the process or fill the memory if damaged."""

from __future__ import annotations

import struct

import pyarrow as pa

from upvl_cli.datasets.py123d.library import library_errors
from upvl_cli.errors import BadInput

_ARROW, _LAZ = b"\xff\xff\xff\xff", b"LASF"
_MAX_POINTS = 10_000_000  # of a sweep: the densest LiDARs measure half a million
_MAX_RECORDS = 100  # of a LAZ header; the library writes two or three


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


def _check_laz(content: bytes, where: str) -> None:
    """Check the header of a LAZ file (ASPRS LAS 1.4, LASzip): counts of points, of records and of chunks."""
    points = _number("<I", content, 107, where)
    records = _number("<I", content, 100, where)
    if _number("<BB", content, 24, where) >= 4:
        points = max(points, _number("<Q", content, 247, where))
        records = max(records, _number("<I", content, 243, where))
    start = _number("<I", content, 96, where)
    table = _number("<q", content, start, where)
    if table == -1:  # the place of the table is at the end
        table = _number("<q", content, len(content) - 8, where)
    chunks = _number("<I", content, table + 4, where)
    for name, count, limit in (
        ("points", points, _MAX_POINTS),
        ("records", records, _MAX_RECORDS),
        ("chunks", chunks, len(content)),
    ):
        if count > limit:
            raise BadInput(
                f"{where} is a sweep with {count} {name} in {len(content)} bytes, expected at most {limit}; "
                "convert the log again"
            )


def _number(form: str, content: bytes, place: int, where: str) -> int:
    """Return the last number of a form at a place in a file."""
    if not 0 <= place <= len(content) - struct.calcsize(form):
        raise BadInput(f"{where} is a sweep of {len(content)} bytes, expected more; convert the log again")
    return int(struct.unpack_from(form, content, place)[-1])
