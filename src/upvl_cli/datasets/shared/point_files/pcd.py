"""PCD, the format of the Point Cloud Library: a text header, then rows as text, bytes, or compressed columns.

Of the header the fields and the number of points matter. `VIEWPOINT` is where the sensor stood, which no tool agrees
on applying: points are taken as they stand.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from upvl_cli.datasets.shared.point_files.lzf import decompress
from upvl_cli.datasets.shared.point_files.scan import MOST_BYTES, ScanPoints, scan_points
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

START = re.compile(rb"(?:\xef\xbb\xbf)?\s*(?:#[^\n]*\n\s*)*(?:VERSION|FIELDS|COLUMNS)\s")
_MOST_HEADER = 1 << 16
_KINDS = {"F": ("f", (4, 8)), "U": ("u", (1, 2, 4, 8)), "I": ("i", (1, 2, 4, 8))}
_MOST_COUNT = 4096  # values of one field: descriptors have some hundred
_DATA = ("ascii", "binary", "binary_compressed")
_WHOLE = re.compile(r"\d{1,12}")
_BEST_RATIO = 264 / 3  # of LZF: three bytes stand for 264


@dataclass(frozen=True)
class PcdHeader:
    """What the header says.

    Attributes:
        names: Name of each field; unique.
        dtypes: numpy's type of each field, for example "<f4".
        counts: How many values each has.
        points: Number of points.
        data: "ascii", "binary" or "binary_compressed".
        start: Where the data start in the file.
    """

    names: tuple[str, ...]
    dtypes: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    data: str
    start: int

    @property
    def row(self) -> np.dtype[np.void]:
        """One point."""
        return np.dtype(list(zip(self.names, self.dtypes, [(count,) for count in self.counts], strict=True)))


def read_pcd(content: bytes, where: str) -> ScanPoints:
    """Return the sweep of a PCD file.

    Args:
        content: The bytes of the file.
        where: The file, for messages.

    Raises:
        BadInput: The header is damaged, or the data are not what it announces.
    """
    header = _header(content, where)
    body = memoryview(content)[header.start :]
    if header.data == "ascii":
        columns = _ascii(header, bytes(body), where)
    elif header.data == "binary":
        columns = _binary(header, body, where)
    else:
        columns = _compressed(header, body, where)
    used = {name: values[:, 0] for name, values in columns.items() if values.shape[1]}
    return scan_points(used, f"PCD {header.data} with {', '.join(header.names)}"[:200], where)


def _header(content: bytes, where: str) -> PcdHeader:
    found = re.search(rb"(?:^|\n)[ \t]*DATA[ \t]+(\w+)[ \t]*\r?(?:\n|$)", content[:_MOST_HEADER])
    if found is None:
        raise BadInput(
            f"{where}: its PCD header has no line DATA; expected DATA ascii, binary or binary_compressed"
        )
    entries: dict[str, list[str]] = {}
    for line in content[: found.start()].decode("latin-1").splitlines():
        words = line.split()
        if words:
            entries.setdefault(words[0].upper(), words[1:])
    data = found[1].decode("latin-1").lower()
    if data not in _DATA:
        raise BadInput(f"{where}: its PCD header says DATA {data[:40]!r}; expected one of {', '.join(_DATA)}")
    names = entries.get("FIELDS") or entries.get("COLUMNS") or []
    sizes, kinds = entries.get("SIZE", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise BadInput(
            f"{where}: its PCD header has {len(names)} FIELDS, {len(sizes)} SIZE, {len(kinds)} TYPE and "
            f"{len(counts)} COUNT; expected one of each a field"
        )
    fields = [_field(*field, where) for field in zip(names, sizes, kinds, counts, strict=True)]
    return PcdHeader(
        names=_unique(names),
        dtypes=tuple(dtype for dtype, _ in fields),
        counts=tuple(count for _, count in fields),
        points=_points(entries, where),
        data=data,
        start=found.end(),
    )


def _field(name: str, size: str, kind: str, count: str, where: str) -> tuple[str, int]:
    letter, sizes = _KINDS.get(kind.upper(), ("", ()))
    if not (size.isascii() and size.isdigit() and len(size) < 3 and int(size) in sizes):
        raise BadInput(
            f"{where}: field {name[:40]!r} of its PCD header has TYPE {kind[:9]} and SIZE {size[:9]}; expected "
            "F of 4 or 8 bytes, U or I of 1, 2, 4 or 8"
        )
    if not (_WHOLE.fullmatch(count, endpos=9) and count.isascii() and int(count) <= _MOST_COUNT):
        raise BadInput(
            f"{where}: field {name[:40]!r} of its PCD header has COUNT {count[:20]}; expected 0 to {_MOST_COUNT}"
        )
    return f"<{letter}{size}", int(count)


def _unique(names: list[str]) -> tuple[str, ...]:
    """Return the names; one that comes again, as `_` for padding does, is numbered."""
    seen: dict[str, None] = {}
    for place, name in enumerate(names):
        seen[name if name not in seen else f"{name} {place}"] = None
    return tuple(seen) if len(seen) == len(names) else tuple(f"{name} {k}" for k, name in enumerate(names))


def _points(entries: dict[str, list[str]], where: str) -> int:
    """Return the number of points; raises `BadInput` where the header contradicts itself."""
    numbers = {}
    for key in ("WIDTH", "HEIGHT", "POINTS"):
        words = entries.get(key, [])
        if words and not (len(words) == 1 and words[0].isascii() and _WHOLE.fullmatch(words[0])):
            raise BadInput(
                f"{where}: its PCD header says {key} {' '.join(words)[:40]}; expected a whole number"
            )
        if words:
            numbers[key] = int(words[0])
    area = numbers["WIDTH"] * numbers["HEIGHT"] if "WIDTH" in numbers and "HEIGHT" in numbers else None
    points = numbers.get("POINTS", area)
    if points is None or (area is not None and area != points):
        said = ", ".join(f"{key} {number}" for key, number in numbers.items()) or "nothing"
        raise BadInput(f"{where}: its PCD header says {said}; expected POINTS to be WIDTH times HEIGHT")
    return points


def _too_few(header: PcdHeader, found: str, where: str) -> BadInput:
    return BadInput(
        f"{where}: its PCD header announces {header.points} points of {header.row.itemsize} bytes, {found}: it is cut "
        "off or damaged; copy it again, or remove it to skip it"
    )


def _ascii(header: PcdHeader, body: bytes, where: str) -> dict[str, Array]:
    words = body.split()
    width = sum(header.counts)
    if len(words) != header.points * width or not width:
        raise BadInput(
            f"{where}: its PCD header announces {header.points} points of {width} numbers, but {len(words)} numbers "
            "follow: it is cut off or damaged; copy it again, or remove it to skip it"
        )
    try:
        values = np.fromiter(map(float, words), np.float64, len(words)).reshape(header.points, width)
    except ValueError:
        raise BadInput(
            f"{where}: its PCD data are not all numbers; copy it again, or remove it to skip it"
        ) from None
    ends = np.cumsum(header.counts)
    return {
        name: values[:, end - count : end]
        for name, count, end in zip(header.names, header.counts, ends.tolist(), strict=True)
    }


def _binary(header: PcdHeader, body: memoryview, where: str) -> dict[str, Array]:
    if header.row.itemsize * header.points > len(body) or not header.row.itemsize:
        raise _too_few(header, f"but {len(body)} bytes follow", where)
    rows = np.frombuffer(body, header.row, header.points)
    return {name: rows[name] for name in header.names}


def _compressed(header: PcdHeader, body: memoryview, where: str) -> dict[str, Array]:
    sizes = np.frombuffer(body[:8], "<u4").tolist() if len(body) >= 8 else [0, 0]
    packed, size = body[8 : 8 + sizes[0]], header.row.itemsize * header.points
    if len(packed) < sizes[0] or sizes[1] != size or size > min(MOST_BYTES, len(packed) * _BEST_RATIO):
        raise _too_few(
            header, f"but {len(packed)} of {sizes[0]} compressed bytes follow, for {sizes[1]} bytes", where
        )
    values = decompress(bytes(packed), size)
    if values is None:
        raise _too_few(header, "but its compressed data do not unpack to that", where)
    columns, start = {}, 0
    for name, dtype, count in zip(header.names, header.dtypes, header.counts, strict=True):
        total = header.points * count
        columns[name] = np.frombuffer(values, dtype, total, start).reshape(header.points, count)
        start += total * np.dtype(dtype).itemsize
    return columns
