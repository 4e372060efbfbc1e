"""Counts in stored sweeps that are damaged: a decoder would end the process, or never end."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

pytest.importorskip("py123d.api", reason="needs the extra py123d")

from py123d.common.io.lidar.draco_lidar_io import encode_point_cloud_as_draco_binary
from py123d.common.io.lidar.ipc_lidar_io import encode_point_cloud_as_ipc_binary
from py123d.common.io.lidar.laz_lidar_io import encode_point_cloud_as_laz_binary

from upvl_cli.datasets.py123d.stored import check_stored_sweep
from upvl_cli.errors import BadInput

XYZ = np.random.default_rng(0).uniform(-9, 9, (500, 3)).astype(np.float32)
LAZ = encode_point_cloud_as_laz_binary(XYZ, {"ids": np.zeros(500, np.uint8)})
DRACO = encode_point_cloud_as_draco_binary(XYZ, {"ids": np.zeros(500, np.uint8), "t": np.arange(500)})
PLAIN_DRACO = encode_point_cloud_as_draco_binary(XYZ)
POINT_DATA = struct.unpack_from("<I", LAZ, 96)[0]
CHUNK_TABLE = struct.unpack_from("<q", LAZ, POINT_DATA)[0]


def laz(form: str, place: int, value: int) -> bytes:
    """The sweep with another number at a place."""
    content = bytearray(LAZ)
    struct.pack_into(form, content, place, value)
    return bytes(content)


def draco(old: int, new: int) -> bytes:
    """The sweep with another number instead of one."""
    return bytes(DRACO.replace(struct.pack("<I", old), struct.pack("<I", new), 1))


DAMAGES = [
    ("points, as before 1.4", laz("<I", 107, 2**32 - 1), "a sweep with 4294967295 points"),
    ("points", laz("<Q", 247, 2**40), "a sweep with 1099511627776 points"),
    ("records", laz("<I", 100, 2**31), "a sweep with 2147483648 records"),
    ("records at the end", laz("<I", 243, 2**31), "a sweep with 2147483648 records"),
    ("chunks", laz("<I", CHUNK_TABLE + 4, 2**31), "a sweep with 2147483648 chunks"),
    ("a table of chunks behind the end", laz("<q", POINT_DATA, 2**50), "expected more"),
    ("a table of chunks before the start", laz("<q", POINT_DATA, -7), "expected more"),
    ("points behind the end", laz("<I", 96, 2**31), "expected more"),
    ("a table of chunks nowhere", laz("<q", POINT_DATA, -1), "expected more"),
    ("cut in its header", LAZ[:90], "expected more"),
    ("Draco: points", draco(len(XYZ), 2**31), "a sweep with 2147483648 points"),
    ("Draco: more points than bits", draco(len(XYZ), 100 * len(DRACO) + 1), "points in"),
    (
        "Draco without features: points",
        PLAIN_DRACO[:11] + b"\xff" * 4 + PLAIN_DRACO[15:],
        "a sweep with 4294967295",
    ),
    ("Draco: records", DRACO[:11] + b"\xff\xff\x7f" + DRACO[14:], "a sweep with 2097151 records"),
    ("Draco: entries", DRACO[:13] + b"\xff\x01" + DRACO[15:], "a sweep with 255 records"),
    ("Draco: a name behind the end", DRACO[:14] + b"\xff" + DRACO[15:], "records|expected more|points"),
    ("Draco: cut in its metadata", DRACO[:30], "expected more"),
]


@pytest.mark.parametrize(
    ("content", "message"), [case[1:] for case in DAMAGES], ids=[case[0] for case in DAMAGES]
)
def test_damaged_counts(content: bytes, message: str) -> None:
    for whole in (LAZ, DRACO, PLAIN_DRACO):
        check_stored_sweep(whole, "sweep 1")
    with pytest.raises(BadInput, match=f"^sweep 1 is .*({message})"):
        check_stored_sweep(content, "sweep 1")


def test_a_table_of_chunks_that_the_end_names() -> None:
    """As programs write it that cannot go back."""
    content = laz("<q", POINT_DATA, -1) + struct.pack("<q", CHUNK_TABLE)
    check_stored_sweep(content, "sweep 1")


@pytest.mark.parametrize("codec", [None, "lz4", "zstd"])
def test_lengths_of_an_arrow_stream(codec: Any) -> None:
    content = encode_point_cloud_as_ipc_binary(XYZ, codec=codec)
    check_stored_sweep(content, "sweep 1")
    with pytest.raises(BadInput, match="^sweep 1 cannot be read by py123d"):
        check_stored_sweep(content[:300], "sweep 1")


def test_an_arrow_stream_with_fewer_numbers_than_it_says() -> None:
    content = encode_point_cloud_as_ipc_binary(XYZ, codec=None)
    longer = content.replace(struct.pack("<q", len(XYZ)), struct.pack("<q", 2**30))
    assert longer != content
    with pytest.raises(BadInput, match="^sweep 1 cannot be read by py123d"):
        check_stored_sweep(longer, "sweep 1")
