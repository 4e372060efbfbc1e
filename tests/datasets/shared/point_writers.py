"""Write points as PCD and PLY, plainly: what the readers are held against."""

from __future__ import annotations

import numpy as np

NAMES = ("x", "y", "z", "intensity")


def pcd(rows: np.ndarray, data: str) -> bytes:
    """(n, 4) float32 as a PCD file with DATA `data`."""
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        f"FIELDS {' '.join(NAMES)}\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {data}\n"
    ).encode()
    rows = rows.astype("<f4")
    if data == "ascii":
        return header + text(rows)
    if data == "binary":
        return header + rows.tobytes()
    columns = rows.T.tobytes()
    packed = compress(columns)
    return header + np.array([len(packed), len(columns)], "<u4").tobytes() + packed


def ply(rows: np.ndarray, form: str, *, lists: bool = False) -> bytes:
    """(n, 4) float32 as a PLY file; with `lists` an element of lists stands before, and a list in each row."""
    lines = ["ply", f"format {form} 1.0", "comment made by hand"]
    if lists:
        lines += ["element face 2", "property list uchar int vertex_indices"]
    lines += [f"element vertex {len(rows)}", *(f"property float {name}" for name in NAMES)]
    if lists:
        lines += ["property list uchar ushort neighbours"]
    header = "\n".join([*lines, "end_header", ""]).encode()
    order = ">" if form.endswith("big_endian") else "<"
    if form == "ascii":
        body = [b"3 0 1 2\n4 0 1 2 3\n"] if lists else []
        for row in rows:
            body.append(text(row[None]).rstrip() + (b" 2 7 8\n" if lists else b"\n"))
        return header + b"".join(body)
    if not lists:
        return header + rows.astype(f"{order}f4").tobytes()
    body = [
        b"\3" + np.arange(3, dtype=f"{order}i4").tobytes(),
        b"\4" + np.arange(4, dtype=f"{order}i4").tobytes(),
    ]
    for row in rows:
        body.append(row.astype(f"{order}f4").tobytes() + b"\2" + np.array([7, 8], f"{order}u2").tobytes())
    return header + b"".join(body)


def text(rows: np.ndarray) -> bytes:
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows).encode()


def compress(plain: bytes) -> bytes:
    """LZF, greedily: a reference to the latest place that began with the same three bytes, or literals."""
    out, literal, seen, place = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(literal), 32):
            part = literal[start : start + 32]
            out.append(len(part) - 1)
            out.extend(part)
        literal.clear()

    while place < len(plain):
        key = plain[place : place + 3]
        found = seen.get(key, -1)
        seen[key] = place
        back = place - found - 1
        if len(key) < 3 or found < 0 or back >= 8192:
            literal.append(plain[place])
            place += 1
            continue
        length = 3
        while length < 264 and place + length < len(plain) and plain[found + length] == plain[place + length]:
            length += 1
        flush()
        if length < 9:
            out.append((length - 2) << 5 | back >> 8)
        else:
            out.extend([7 << 5 | back >> 8, length - 9])
        out.append(back & 255)
        place += length
    flush()
    return bytes(out)
