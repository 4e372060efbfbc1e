"""Files of points: recognised by content, read whole, or refused in one line."""

from __future__ import annotations

import gzip
import io
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.shared.point_writers import compress, pcd, ply
from upvl_cli.datasets.shared.point_files.bin import recognise_rows
from upvl_cli.datasets.shared.point_files.lzf import decompress
from upvl_cli.datasets.shared.point_files.read import parse_points, read_points
from upvl_cli.errors import BadInput

SHARED = Path(__file__).parents[3] / ".." / "shared" / "data"


def street(total: int = 4000, seed: int = 0) -> np.ndarray:
    """(n, 6) x, y, z, intensity, ring, time of a sweep that turns around on a plane with a wall."""
    random = np.random.default_rng(seed)
    ring = np.arange(total) % 32
    angle_rad = 2 * np.pi * np.arange(total) / total
    down_rad = np.deg2rad(-25 + ring)
    reach_m = np.minimum(1.8 / np.maximum(-np.sin(down_rad), 1e-3), 30 + 5 * np.sin(3 * angle_rad))
    xyz = reach_m[:, None] * np.stack(
        [np.cos(angle_rad) * np.cos(down_rad), np.sin(angle_rad) * np.cos(down_rad), np.sin(down_rad)], axis=1
    )
    xyz += random.normal(0, 0.01, xyz.shape)
    intensity = np.round(random.uniform(0, 1, total), 2)
    return np.column_stack([xyz, intensity, ring, np.linspace(0, 0.1, total)])


ROWS = street()


@pytest.mark.parametrize("columns", [3, 4, 5, 6])
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("is_shuffled", [False, True])
def test_rows_of_floats_are_recognised(columns: int, dtype: str, is_shuffled: bool) -> None:
    rows = np.random.default_rng(1).permutation(ROWS) if is_shuffled else ROWS
    found = recognise_rows(rows[:, :columns].astype(dtype).tobytes())
    if found is None:  # x, y and z alone, in any order, are much alike
        assert is_shuffled
        assert columns == 3
        return
    assert (found.dtype, found.columns) == (dtype, columns)


@pytest.mark.parametrize("columns", [3, 4, 5, 6])
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", ">f8"])
@pytest.mark.parametrize("expected", [4, 5])
def test_another_layout_than_expected_is_named(columns: int, dtype: str, expected: int) -> None:
    """The 960 rows divide by all widths: only the numbers can tell."""
    content = ROWS[:960, :columns].astype(dtype).tobytes()
    if (dtype, columns) == ("<f4", expected):
        scan = parse_points(content, expected, "a.bin")
        np.testing.assert_array_equal(scan.xyz_m, ROWS[:960, :3].astype("f4"))
        return
    words = {"<f4": "float32", ">f4": "big-endian float32", "<f8": "float64", ">f8": "big-endian float64"}
    with pytest.raises(
        BadInput, match=rf"a\.bin holds {columns} columns of {words[dtype]} .*expected {expected} "
    ):
        parse_points(content, expected, "a.bin")
    free = parse_points(content, None, "a.bin")
    np.testing.assert_array_equal(free.xyz_m, ROWS[:960, :3].astype("f4"))
    assert free.layout.startswith(words[dtype])


def npy(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


XYZI = ROWS[:500, :4].astype("<f4")
NAMED = np.rec.fromarrays([*XYZI.T, np.arange(500)], names="x,y,z,Intensity,timestamp")
FILES: dict[str, Callable[[], bytes]] = {
    "bin": lambda: XYZI.tobytes(),
    "pcd ascii": lambda: pcd(XYZI, "ascii"),
    "pcd binary": lambda: pcd(XYZI, "binary"),
    "pcd compressed": lambda: pcd(XYZI, "binary_compressed"),
    "pcd with a mark": lambda: b"\xef\xbb\xbf" + pcd(XYZI, "ascii"),
    "ply ascii": lambda: ply(XYZI, "ascii"),
    "ply little": lambda: ply(XYZI, "binary_little_endian"),
    "ply big": lambda: ply(XYZI, "binary_big_endian"),
    "ply with lists": lambda: ply(XYZI, "binary_big_endian", lists=True),
    "ply ascii with lists": lambda: ply(XYZI, "ascii", lists=True),
    "npy": lambda: npy(XYZI),
    "npy of columns": lambda: npy(np.asfortranarray(XYZI)),
    "npy on its side": lambda: npy(XYZI.T),
    "npy of an image": lambda: npy(XYZI.reshape(10, 50, 4)),
    "npy with names": lambda: npy(np.asarray(NAMED)),
    "npz": lambda: npz(points=XYZI),
    "npz of parts": lambda: npz(xyz=XYZI[:, :3], intensity=XYZI[:, 3:], ring=np.zeros(500, "u1")),
    "npz of columns": lambda: npz(x=XYZI[:, 0], y=XYZI[:, 1], z=XYZI[:, 2], reflectance=XYZI[:, 3]),
    "gzip": lambda: gzip.compress(pcd(XYZI, "binary")),
}


@pytest.mark.parametrize("name", FILES)
def test_each_format_gives_the_same_points(name: str) -> None:
    scan = parse_points(FILES[name](), None, "a.xyz")
    np.testing.assert_allclose(scan.xyz_m, XYZI[:, :3], rtol=1e-6)
    assert scan.intensity is not None
    np.testing.assert_allclose(scan.intensity, XYZI[:, 3], rtol=1e-6)
    assert not scan.skipped


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("pcd binary", "is a PCD file"),
        ("npy", "is a npy file"),
        ("npz", "is a npz or zip file"),
        ("gzip", "is compressed by gzip"),
        ("ply ascii", "is a PLY file"),
    ],
)
def test_another_format_than_expected_is_named(name: str, words: str) -> None:
    with pytest.raises(BadInput, match=f"a.bin {words}, expected raw rows of 4 float32"):
        parse_points(FILES[name](), 4, "a.bin")


@pytest.mark.parametrize("name", ["bin", "pcd ascii", "pcd binary", "ply big", "npy"])
def test_rays_without_return_are_dropped_and_counted(name: str) -> None:
    rows = XYZI.copy()
    rows[10:15] = np.nan
    rows[20:23, :3] = 0
    makers = {
        "bin": rows.tobytes, "pcd ascii": lambda: pcd(rows, "ascii"), "pcd binary": lambda: pcd(rows, "binary"),
        "ply big": lambda: ply(rows, "binary_big_endian"), "npy": lambda: npy(rows),
    }  # fmt: skip
    scan = parse_points(makers[name](), None, "a")
    assert sum(scan.skipped.values()) == 8
    assert len(scan) == len(scan.intensity) == 492
    np.testing.assert_allclose(scan.xyz_m[10:], np.delete(rows[15:, :3], slice(5, 8), axis=0), rtol=1e-6)


def test_fields_of_any_type_and_count() -> None:
    """Padding `_`, a descriptor of 33 values and a time of 8 bytes beside what is used."""
    row = np.dtype([("_", "u1", 4), ("x", "<f8"), ("y", "<f4"), ("z", "<i2"), ("fpfh", "<f4", 33), ("ring", "u1"),
                    ("reflectivity", "<u2"), ("t", "<u8")])  # fmt: skip
    rows = np.zeros(7, row)
    rows["x"], rows["y"], rows["z"] = np.arange(7) + 0.5, 2, -1
    rows["ring"], rows["reflectivity"], rows["t"] = np.arange(7), 65535, 10**15 + np.arange(7)
    header = (
        "# .PCD v.7 - Point Cloud Data file format\nVERSION .7\nFIELDS _ x y z fpfh ring reflectivity t\n"
        "SIZE 1 8 4 2 4 1 2 8\nTYPE U F F I F U U U\nCOUNT 4 1 1 1 33 1 1 1\nWIDTH 7\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 7\n"
    )
    columns = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in row.names)
    packed = compress(columns)
    sizes = np.array([len(packed), len(columns)], "<u4").tobytes()
    for content in (
        f"{header}DATA binary\n".encode() + rows.tobytes(),
        f"{header}DATA binary_compressed\n".encode() + sizes + packed,
    ):
        scan = parse_points(content, None, "a.pcd")
        np.testing.assert_array_equal(scan.xyz_m, np.column_stack([rows["x"], rows["y"], rows["z"]]))
        np.testing.assert_array_equal(scan.time, rows["t"])
        np.testing.assert_array_equal(scan.ring, rows["ring"])
        assert scan.intensity.dtype == np.uint16
        assert (scan.intensity == 65535).all()


@given(st.lists(st.binary(max_size=40) | st.sampled_from([b"\0" * 300, b"abc" * 100]), max_size=8))
@settings(max_examples=100, deadline=None)
def test_compressed_data_come_back(parts: list[bytes]) -> None:
    plain = b"".join(parts)
    assert decompress(compress(plain), len(plain)) == plain
    assert decompress(compress(plain), len(plain) + 1) is None


def test_the_size_in_a_damaged_header_reserves_nothing() -> None:
    content = pcd(XYZI, "binary_compressed").replace(b"500", b"999999999999")
    with pytest.raises(BadInput, match="compressed bytes follow"):
        parse_points(content, None, "a.pcd")
    zeros = npz(points=np.zeros((1 << 20, 3), "f4"))
    assert len(parse_points(zeros, None, "a.npz")) == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\0" * 4000, "only zeros"),
        (b"hello world, this is no sweep at all" * 20, "not recognised as points"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        (b"LASF" + bytes(400), "LAS or LAZ"),
        (XYZI.tobytes()[:-7], "cut off"),
    ],
)
def test_what_is_no_sweep_is_named(content: bytes, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        parse_points(content, None, "a.bin")


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="No such file"):
        read_points(tmp_path / "a.bin", 4)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_damage_gives_points_or_one_line(data: st.DataObject) -> None:
    """Bytes changed, cut out, put in or repeated anywhere, most of them in the header."""
    name = data.draw(st.sampled_from(list(FILES)))
    content = bytearray(FILES[name]())
    for _ in range(data.draw(st.integers(1, 4))):
        most = len(content) if data.draw(st.booleans()) else min(len(content), 300)
        place = data.draw(st.integers(0, most))
        kind = data.draw(st.sampled_from(["set", "cut", "end", "insert", "digits"]))
        if kind == "set":
            new = data.draw(st.binary(min_size=1, max_size=8))
            content[place : place + len(new)] = new
        elif kind == "cut":
            del content[place : place + data.draw(st.integers(1, 50))]
        elif kind == "end":
            del content[place:]
        elif kind == "insert":
            content[place:place] = data.draw(st.binary(min_size=1, max_size=20))
        else:
            content[place : place + 2] = data.draw(
                st.sampled_from([b"99999999999", b"-1", b"nan", b"0", b"1e99"])
            )
    with warnings.catch_warnings(action="error"):
        try:
            scan = parse_points(bytes(content), data.draw(st.sampled_from([None, None, 4, 5])), "file")
        except BadInput as error:
            assert "\n" not in str(error)
            assert len(str(error)) < 600
            return
    assert np.isfinite(scan.xyz_m).all()
    for column in (scan.intensity, scan.ring, scan.sensor, scan.time):
        assert column is None or len(column) == len(scan)


@pytest.mark.real
@pytest.mark.parametrize(
    ("pattern", "columns"),
    [
        ("kitti_raw_*/*/*/velodyne_points/data/*[05].bin", 4),
        ("nuscenes_real/*.bin", 5),
        ("vod_real/lidar/*/*/*.bin", 4),
    ],
)
def test_real_sweeps_are_told_apart(pattern: str, columns: int) -> None:
    paths = sorted(SHARED.glob(pattern))
    if not paths:
        pytest.skip("the real drives are not here")
    other = 9 - columns
    for path in paths:
        assert len(read_points(path, columns)) > 10_000
        content = path.read_bytes()
        content = content[: len(content) // 80 * 80]
        with pytest.raises(BadInput, match=f"holds {columns} columns of float32 .*expected {other}"):
            parse_points(content, other, "a.bin")
