"""Rows of Parquet columns, read page by page: the same as pyarrow reads, however the file is written."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.contract import assert_one_line
from upvl_cli.datasets.shared import parquet_pages
from upvl_cli.datasets.shared.parquet_columns import BytesColumn, ListColumn
from upvl_cli.datasets.shared.thrift import ShortInput, read_struct, write_struct
from upvl_cli.errors import BadInput
from upvl_cli.types import Array

NAME = "a.values"
WAYS = list(
    itertools.product(
        ["none", "snappy", "zstd", "gzip", "lz4", "brotli"],
        [1, 7, 1000],
        [300, 1 << 20],
        ["1.0", "2.0"],
        [True, False],
    )
)


def rows_of(rng: np.random.Generator, total: int = 20) -> list[Array | None]:
    """Rows of any length, among them empty and null ones; some with few different values."""
    found: list[Array | None] = []
    for _ in range(total):
        kind = rng.integers(0, 6)
        length = rng.integers(1, 400)
        values = rng.normal(size=length) if kind > 3 else rng.integers(0, 3, length)
        found.append(None if kind == 0 else values.astype(np.float32)[: 0 if kind == 1 else None])
    return found


def write(path: Path, rows: list[Array | None], texts: list[bytes | None], **how: Any) -> None:
    table = pa.table({"other": range(len(rows)), NAME: pa.array(rows, pa.list_(pa.float32())), "text": texts})
    pq.write_table(table, path, **how)


def check(path: Path, rows: list[Array | None], texts: list[bytes | None]) -> None:
    counts = np.array([0 if row is None else len(row) for row in rows])
    order = np.random.default_rng(1).permutation(len(rows)).tolist()
    for column in (ListColumn(path, NAME, counts), ListColumn(path, NAME)):
        for row in order:
            found = column.row(row)
            if counts[row]:
                np.testing.assert_array_equal(found, rows[row])
            else:
                assert found is None
    strings = BytesColumn(path, "text")
    assert [strings.row(row) for row in range(len(rows))] == texts


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_every_way_to_write_a_file(way: tuple[Any, ...], tmp_path: Path) -> None:
    codec, rows_per_group, page_bytes, version, has_dictionary = way
    rng = np.random.default_rng(rows_per_group)
    rows = rows_of(rng)
    texts = [None if row is None else rng.bytes(len(row) // 4) for row in rows]
    write(
        tmp_path / "a.parquet",
        rows,
        texts,
        compression=codec,
        row_group_size=rows_per_group,
        data_page_size=page_bytes,
        data_page_version=version,
        use_dictionary=has_dictionary,
    )
    check(tmp_path / "a.parquet", rows, texts)


@pytest.mark.parametrize(
    ("numbers", "strings"), [("BYTE_STREAM_SPLIT", "DELTA_BYTE_ARRAY"), ("PLAIN", "DELTA_LENGTH_BYTE_ARRAY")]
)
def test_other_encodings(numbers: str, strings: str, tmp_path: Path) -> None:
    rows = rows_of(np.random.default_rng(0))
    texts = [bytes([row % 7] * row) for row in range(len(rows))]
    encoding = {f"{NAME}.list.element": numbers, "text": strings}
    write(tmp_path / "a.parquet", rows, texts, use_dictionary=False, column_encoding=encoding)
    check(tmp_path / "a.parquet", rows, texts)


@pytest.mark.parametrize("kind", [pa.int32(), pa.int64(), pa.float64()])
def test_other_numbers(kind: pa.DataType, tmp_path: Path) -> None:
    cells = [[1, 2, 3], [4], [-5, 6]]
    pq.write_table(pa.table({NAME: pa.array(cells, pa.list_(kind))}), tmp_path / "a.parquet")
    column = ListColumn(tmp_path / "a.parquet", NAME)
    assert [column.row(row).tolist() for row in range(3)] == cells  # type: ignore[union-attr]


def test_only_the_pages_of_a_row_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.parquet"
    rows: list[Array | None] = [
        np.random.default_rng(row).normal(size=1000).astype(np.float32) for row in range(200)
    ]
    write(path, rows, [None] * 200, use_dictionary=False, data_page_size=1000, write_batch_size=100)
    read: list[int] = []
    plain = parquet_pages.ColumnChunk._bytes

    def counted(self: Any, file: int, position: int, count: int) -> bytes:
        read.append(count)
        return plain(self, file, position, count)

    monkeypatch.setattr(parquet_pages.ColumnChunk, "_bytes", counted)
    column = ListColumn(path, NAME, np.full(200, 1000))
    np.testing.assert_array_equal(column.row(150), rows[150])
    headers = sum(count for count in read if count <= 96)
    assert sum(read) - headers < 3 * 4000 < path.stat().st_size / 60
    before = len(read)
    column.row(149)
    assert len(read) - before < 10  # the places of pages are known now


def test_counts_that_are_not_those_of_the_lists_are_refused(tmp_path: Path) -> None:
    rows: list[Array | None] = [np.ones(4, np.float32), np.ones(6, np.float32), None]
    write(tmp_path / "a.parquet", rows, [None] * 3)
    for counts, message in (
        ([5, 5, 0], "no row lies"),
        ([3, 7, 0], "no row lies"),
        ([4, 5, 0], "hold 11 numbers, expected 10"),
        ([4, 6], "has 3 rows, expected 2"),
    ):
        with pytest.raises(BadInput, match=message):
            ListColumn(tmp_path / "a.parquet", NAME, np.array(counts)).row(0)
    with pytest.raises(BadInput, match="expected a row 3"):
        ListColumn(tmp_path / "a.parquet", NAME).row(3)


def test_nulls_inside_a_list_are_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({NAME: [[1.0, None, 3.0], [4.0]]}), tmp_path / "a.parquet")
    column = ListColumn(tmp_path / "a.parquet", NAME)
    assert column.row(1) is not None
    with pytest.raises(BadInput, match="1 numbers are null"):
        column.row(0)


def test_columns_of_another_type_are_refused(tmp_path: Path) -> None:
    pq.write_table(
        pa.table({NAME: [1.0], "text": [[b"a"]], "nested": [[[1.0]]], "number": [3]}), tmp_path / "a.parquet"
    )
    for name in (NAME, "missing", "nested"):
        with pytest.raises(BadInput, match="expected lists of numbers"):
            ListColumn(tmp_path / "a.parquet", name)
    with pytest.raises(BadInput, match="expected byte strings"):
        BytesColumn(tmp_path / "a.parquet", "text")
    with pytest.raises(BadInput, match="it holds numbers"):
        BytesColumn(tmp_path / "a.parquet", "number").row(0)


@settings(max_examples=100)
@given(
    st.floats(0, 1),
    st.binary(min_size=1, max_size=6),
    st.booleans(),
    st.sampled_from(["1.0", "2.0"]),
    st.booleans(),
)
def test_damaged_files(
    tmp_path_factory: pytest.TempPathFactory,
    share: float,
    content: bytes,
    cut: bool,
    version: str,
    compress: bool,
) -> None:
    path = tmp_path_factory.mktemp("damage") / "a.parquet"
    rows = rows_of(np.random.default_rng(3), 6)
    codec = "zstd" if compress else "none"
    write(path, rows, [b"abc"] * 6, data_page_version=version, data_page_size=300, compression=codec)
    old = path.read_bytes()
    place = int(share * (len(old) - 1))
    path.write_bytes(old[:place] if cut else old[:place] + content + old[place + len(content) :])
    try:
        column, strings = ListColumn(path, NAME), BytesColumn(path, "text")
        for row in range(6):
            column.row(row)
            strings.row(row)
    except BadInput as error:
        assert_one_line(error)


def test_structures_are_read_as_they_were_written() -> None:
    fields = {1: 5, 2: -7, 5: {1: 300, 15: b"text"}}
    content = write_struct(fields)
    assert read_struct(content, 0) == (fields, len(content))
    for size in range(len(content)):
        with pytest.raises(ShortInput):
            read_struct(content[:size], 0)
    with pytest.raises(ValueError, match="64 bits"):
        read_struct(b"\x15" + b"\xff" * 12, 0)
    with pytest.raises(ValueError, match="too deep"):
        read_struct(b"\x1c" * 20, 0)
