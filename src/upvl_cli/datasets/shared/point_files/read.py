"""Read any file of points: what it is, is recognised by its content and not by its name."""

from __future__ import annotations

import zlib
from pathlib import Path

from upvl_cli.datasets.shared.point_files import npy, pcd, ply
from upvl_cli.datasets.shared.point_files.bin import read_bin
from upvl_cli.datasets.shared.point_files.scan import MOST_BYTES, ScanPoints
from upvl_cli.errors import BadInput

_GZIP_START = b"\x1f\x8b\x08"  # deflate, the only method there is
# What people have tried, and what to do with it.
_OTHERS = {
    b"LASF": "a LAS or LAZ file; save it as PLY or npy",
    b"ASTM-E57": "an E57 file; save it as PLY or PCD",
    b"\x89HDF": "an HDF5 file; save its points as npy",
    b"SQLite format 3": "a ROS 2 recording; give upvl import the folder of the recording",
    b"\x89MCAP": "an MCAP recording; give it to upvl import as it is",
    b"#ROSBAG": "a ROS 1 recording; give it to upvl import as it is",
    b"PAR1": 'a Parquet file; see dataset = "parquet"',
    b"ARROW1": 'a Feather file; see dataset = "argoverse2"',
    b"version https://git-lfs": "a pointer of Git LFS and not the file; run: git lfs pull",
    b"<?xml": "an XML file",
    b"<!DOCTYPE": "a web page: the download went wrong",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
}


def read_points(path: Path, columns: int | None = None) -> ScanPoints:
    """Return the sweep of a file.

    Args:
        path: The file.
        columns: For a data set whose files are rows of so many little-endian float32 (KITTI: 4, nuScenes: 5);
            anything else is refused by name. None reads every format that is known.

    Raises:
        BadInput: The file cannot be read, is damaged, or is not what is expected; the message names what it is.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(
            f"{path} cannot be read ({error.strerror}); check that it is there and readable"
        ) from None
    return parse_points(content, columns, str(path))


def parse_points(content: bytes, columns: int | None, where: str) -> ScanPoints:
    """Return the sweep of the bytes of a file; see `read_points`."""
    kind = format_name(content)
    if columns is not None:
        if kind:
            raise BadInput(
                f"{where} is {kind}, expected raw rows of {columns} float32; read it with the adapter of its data "
                "set, or make a drive of it with: upvl import"
            )
        return read_bin(content, columns, where)
    if content.startswith(_GZIP_START):
        content = _unzipped(content, where)
        kind = format_name(content)
    if kind == "a PCD file":
        return pcd.read_pcd(content, where)
    if kind == "a PLY file":
        return ply.read_ply(content, where)
    if kind == "a npy file":
        return npy.read_npy(content, where)
    if kind == "a npz or zip file":
        return npy.read_npz(content, where)
    if kind:
        raise BadInput(f"{where} is {kind}; expected PCD, PLY, npy, npz, or raw rows of floats")
    return read_bin(content, None, where)


def format_name(content: bytes) -> str:
    """Return which known format the content begins as, in words; empty for raw numbers."""
    if pcd.START.match(content[:65536]):
        return "a PCD file"
    if ply.START.match(content[:16]):
        return "a PLY file"
    if content.startswith(npy.NPY_START):
        return "a npy file"
    if content.startswith(npy.NPZ_START):
        return "a npz or zip file"
    if content.startswith(_GZIP_START):
        return "compressed by gzip"
    return next((name for start, name in _OTHERS.items() if content.startswith(start)), "")


def _unzipped(content: bytes, where: str) -> bytes:
    unpack = zlib.decompressobj(31)
    try:
        unpacked = unpack.decompress(content, MOST_BYTES)
    except zlib.error as error:
        raise BadInput(f"{where} is damaged gzip ({error}); copy it again, or remove it to skip it") from None
    if not unpack.eof:
        raise BadInput(
            f"{where} is gzip that is cut off, or unpacks to more than {MOST_BYTES >> 20} MiB; copy it again"
        )
    return unpacked
