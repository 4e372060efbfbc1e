"""PLY: a text header that declares elements, then their rows as text or bytes. The points are `vertex`."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.shared.point_files.scan import ScanPoints, scan_points
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

START = re.compile(rb"(?:\xef\xbb\xbf)?ply[ \t]*\r?\n")
_MOST_HEADER = 1 << 16
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class PlyProperty:
    """One property of an element; `count` is the type of a list's length, empty for a single number."""

    name: str
    dtype: str
    count: str


@dataclass(frozen=True)
class PlyElement:
    """One declared element with its number of rows."""

    name: str
    rows: int
    properties: tuple[PlyProperty, ...]

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in length."""
        return any(known.count for known in self.properties)


def read_ply(content: bytes, where: str) -> ScanPoints:
    """Return the sweep of a PLY file: its element `vertex`.

    Args:
        content: The bytes of the file.
        where: The file, for messages.

    Raises:
        BadInput: The header is damaged, or the data are not what it announces.
    """
    order, columns = vertex_columns(content, where)
    kind = {"": "ascii", "<": "little-endian", ">": "big-endian"}[order]
    return scan_points(columns, f"PLY {kind} with {', '.join(columns)}"[:200], where)


def vertex_columns(content: bytes, where: str) -> tuple[str, dict[str, Array]]:
    """Return the order of the bytes, empty for text, and all columns of the element `vertex`; see `read_ply`."""
    order, elements, start = _header(content, where)
    body = content[start:]
    words = body.split() if not order else []
    place = 0
    for element in elements:
        size = len(body) if order else len(words)
        if element.rows > size - place and element.properties:
            raise _cut_off(element, where)
        if element.has_lists:
            take = _bytes_reader(body, order) if order else _words_reader(words)
            columns, place = _list_rows(element, take, place, where)
        else:
            columns, place = (
                _binary_rows(element, body, order, place, where)
                if order
                else _text_rows(element, words, place, where)
            )
        if element.name == "vertex":
            return order, columns
    raise BadInput(f"{where}: its PLY header has no element vertex; expected the points there")


def _header(content: bytes, where: str) -> tuple[str, list[PlyElement], int]:
    end = re.search(rb"\nend_header[ \t]*\r?(?:\n|$)", content[:_MOST_HEADER])
    if end is None:
        raise BadInput(
            f"{where}: its PLY header has no line end_header; copy it again, or remove it to skip it"
        )
    order: str | None = None
    elements: list[PlyElement] = []
    for line in content[: end.start()].decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", kind, *_] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, rows] if rows.isascii() and rows.isdigit() and len(rows) < 13:
                elements.append(PlyElement(name, int(rows), ()))
            case ["property", "list", count, kind, name] if elements and _is_list(count, kind):
                elements[-1] = _with(elements[-1], PlyProperty(name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1] = _with(elements[-1], PlyProperty(name, _TYPES[kind], ""))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise BadInput(
                    f"{where}: its PLY header holds {line[:80]!r}; expected format, element, property or comment"
                )
    if order is None:
        raise BadInput(f"{where}: its PLY header has no format; expected one of {', '.join(_ORDERS)}")
    return order, elements, end.end()


def _is_list(count: str, kind: str) -> bool:
    return kind in _TYPES and _TYPES.get(count, "f")[0] in "iu"


def _with(element: PlyElement, added: PlyProperty) -> PlyElement:
    if any(known.name == added.name for known in element.properties):
        added = PlyProperty(f"{added.name} {len(element.properties)}", added.dtype, added.count)
    return PlyElement(element.name, element.rows, (*element.properties, added))


def _cut_off(element: PlyElement, where: str) -> BadInput:
    return BadInput(
        f"{where}: its PLY header announces {element.rows} rows of {element.name[:40]!r}, and the data end before: it "
        "is cut off or damaged; copy it again, or remove it to skip it"
    )


def _binary_rows(
    element: PlyElement, body: bytes, order: str, start: int, where: str
) -> tuple[dict[str, Array], int]:
    row = np.dtype([(known.name, order + known.dtype) for known in element.properties])
    end = start + row.itemsize * element.rows
    if end > len(body):
        raise _cut_off(element, where)
    if not row.itemsize:
        return {}, start
    rows = np.frombuffer(body, row, element.rows, start)
    return {known.name: rows[known.name] for known in element.properties}, end


def _text_rows(
    element: PlyElement, words: list[bytes], start: int, where: str
) -> tuple[dict[str, Array], int]:
    width = len(element.properties)
    end = start + width * element.rows
    if end > len(words):
        raise _cut_off(element, where)
    try:
        values = np.fromiter(map(float, words[start:end]), np.float64, end - start)
    except ValueError:
        raise BadInput(
            f"{where}: its PLY data are not all numbers; copy it again, or remove it to skip it"
        ) from None
    rows = values.reshape(-1, width) if width else values.reshape(0, 0)
    return {known.name: rows[:, place] for place, known in enumerate(element.properties)}, end


Take = Callable[[str, int, int], tuple[Array | None, int]]


def _bytes_reader(body: bytes, order: str) -> Take:
    def take(dtype: str, count: int, start: int) -> tuple[Array | None, int]:
        """Return `count` numbers from a place on, and the place behind them; None where they are not there."""
        end = start + count * np.dtype(dtype).itemsize
        return (np.frombuffer(body, order + dtype, count, start), end) if end <= len(body) else (None, start)

    return take


def _words_reader(words: list[bytes]) -> Take:
    def take(dtype: str, count: int, start: int) -> tuple[Array | None, int]:
        """Return `count` numbers from a word on, and the word behind them; None where they are not there."""
        end = start + count
        try:
            values = np.fromiter(map(float, words[start:end]), np.float64)
        except ValueError:
            return None, start
        return (values, end) if len(values) == count else (None, start)

    return take


def _list_rows(element: PlyElement, take: Take, start: int, where: str) -> tuple[dict[str, Array], int]:
    """Return the single numbers of rows that hold lists as well, one row after the other."""
    columns: dict[str, list[float]] = {known.name: [] for known in element.properties if not known.count}
    for _ in range(element.rows):
        for known in element.properties:
            values, start = take(known.count or known.dtype, 1, start)
            if values is not None and known.count:
                length = float(values[0])
                is_length = 0 <= length < 1e9 and length == int(length)
                values, start = take(known.dtype, int(length), start) if is_length else (None, start)
            elif values is not None:
                columns[known.name].append(float(values[0]))
            if values is None:
                raise _cut_off(element, where)
    return {name: np.array(values) for name, values in columns.items()}, start
