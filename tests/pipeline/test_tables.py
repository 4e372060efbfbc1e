"""Shards are whole or absent, the same bytes twice, and give back what was put in."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from upvl_cli.errors import NotMade, UpvlError
from upvl_cli.pipeline import tables
from upvl_cli.pipeline.stage import Row, column
from upvl_cli.pipeline.tables import Table, read_footer, write
from upvl_cli.types import Array


@dataclass(frozen=True)
class ThingRow(Row):
    time_ns: int = column("int64", "time")
    pose: Array = column("float64", "pose", shape=(2, 2))
    flow_mps: Array = column("float16", "flow", per="point", shape=(3,))
    is_far: Array = column("bool", "far", per="point")


def thing(frame: int, points: int) -> ThingRow:
    flow = np.arange(points * 3, dtype=np.float32).reshape(points, 3)
    return ThingRow("drive", frame, 10 * frame, np.eye(2) * frame, flow, np.arange(points) % 2 == 0)


def save(path: Path, *rows: ThingRow) -> None:
    write(path, ThingRow, rows, stamp="{}", counts={"kept": 3})


@pytest.mark.parametrize("points", [0, 1, 4])
def test_a_row_comes_back_as_it_was(tmp_path: Path, points: int) -> None:
    path = tmp_path / "thing" / "drive.parquet"
    save(path, thing(3, 2), thing(7, points))
    row = Table(path, ThingRow)[7]
    assert (row.segment, row.frame, row.time_ns) == ("drive", 7, 70)
    np.testing.assert_array_equal(row.pose, np.eye(2) * 7)
    np.testing.assert_array_equal(row.flow_mps, np.arange(points * 3).reshape(points, 3))
    np.testing.assert_array_equal(row.is_far, np.arange(points) % 2 == 0)
    assert row.flow_mps.dtype == np.float16


def test_one_row_group_a_frame(tmp_path: Path) -> None:
    save(tmp_path / "drive.parquet", thing(1, 2), thing(2, 3))
    assert Table(tmp_path / "drive.parquet", ThingRow).frames == (1, 2)
    assert pa.parquet.read_metadata(tmp_path / "drive.parquet").num_row_groups == 2


def test_a_shard_without_rows_can_be_read(tmp_path: Path) -> None:
    save(tmp_path / "drive.parquet")
    assert len(Table(tmp_path / "drive.parquet", ThingRow)) == 0


def test_the_same_rows_give_the_same_bytes(tmp_path: Path) -> None:
    save(tmp_path / "a.parquet", thing(1, 5))
    save(tmp_path / "b.parquet", thing(1, 5))
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


def test_the_footer_tells_stamp_counts_and_rows(tmp_path: Path) -> None:
    save(tmp_path / "drive.parquet", thing(1, 5))
    footer = read_footer(tmp_path / "drive.parquet")
    assert footer is not None
    assert (footer.stamp, footer.counts, footer.rows) == ("{}", {"kept": 3}, 1)


def test_a_failure_leaves_the_old_shard_and_no_part(tmp_path: Path) -> None:
    path = tmp_path / "drive.parquet"
    save(path, thing(1, 5))
    before = path.read_bytes()

    def broken():  # noqa: ANN202
        yield thing(1, 1)
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        write(path, ThingRow, broken(), stamp="{}", counts={})
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["drive.parquet"]


# A Parquet writer that never came to be closed says so when it goes.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_ctrl_c_at_any_line_leaves_no_part(tmp_path: Path) -> None:
    path = tmp_path / "drive.parquet"

    def save_until(line: int) -> int:
        """Save, with a Ctrl-C at this line of those that write a shard; how many lines there were."""
        passed = 0

        def trace(frame: FrameType, event: str, _: object) -> Callable[..., Any] | None:
            nonlocal passed
            if frame.f_code.co_filename != tables.__file__:
                return None
            if event == "line":
                passed += 1
                if passed == line:
                    raise KeyboardInterrupt
            return trace

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            save(path, thing(1, 5))
        finally:
            sys.settrace(before)
        return passed

    lines = save_until(0)
    whole = path.read_bytes()
    for line in range(1, lines + 1):
        path.unlink(missing_ok=True)
        with pytest.raises(KeyboardInterrupt):
            save_until(line)
        left = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
        assert left in ({}, {"drive.parquet": whole}), f"line {line} of {lines}"


def test_what_a_killed_run_left_is_written_over(tmp_path: Path) -> None:
    (tmp_path / ".drive.parquet.part").write_bytes(b"half a shard")
    save(tmp_path / "drive.parquet", thing(1, 5))
    assert [entry.name for entry in tmp_path.iterdir()] == ["drive.parquet"]
    assert Table(tmp_path / "drive.parquet", ThingRow).frames == (1,)


@pytest.mark.parametrize(
    "row",
    [
        ThingRow("drive", 1, 1, np.eye(3), np.zeros((2, 3)), np.zeros(2, bool)),
        ThingRow("drive", 1, 1, np.eye(2), np.zeros((2, 2)), np.zeros(2, bool)),
        ThingRow("drive", 1, 1, np.eye(2), np.zeros((2, 3)), np.zeros(3, bool)),
        ThingRow("drive", 1, 1, np.eye(2), np.full((2, 3), np.nan), np.zeros(2, bool)),
    ],
    ids=["wrong pose", "wrong width", "other length", "NaN"],
)
def test_a_row_unlike_its_declaration_is_a_bug(tmp_path: Path, row: ThingRow) -> None:
    with pytest.raises(ValueError, match="column"):
        save(tmp_path / "drive.parquet", row)
    assert not list(tmp_path.iterdir())


def test_a_missing_shard_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(NotMade, match="has not been made; run: make flow"):
        Table(tmp_path / "flow" / "drive.parquet", ThingRow)


def test_a_cut_shard_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "drive.parquet"
    save(path, thing(1, 5))
    path.write_bytes(path.read_bytes()[:-20])
    assert read_footer(path) is None
    with pytest.raises(NotMade, match="is damaged .*; delete it and make it again"):
        Table(path, ThingRow)


def test_a_shard_with_other_columns_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "drive.parquet", Row, [Row("drive", 1)], stamp="{}", counts={})
    with pytest.raises(NotMade, match="has no column time_ns, pose, flow_mps, is_far"):
        Table(tmp_path / "drive.parquet", ThingRow)


def test_a_folder_that_is_a_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "flow").write_text("not a folder")
    with pytest.raises(UpvlError, match="cannot write .*--out"):
        save(tmp_path / "flow" / "drive.parquet", thing(1, 1))


@dataclass(frozen=True)
class ShortRow(Row):
    code: Array = column("int8", "code", per="point", shape=(64,))


@pytest.mark.parametrize("points", [0, 300])
def test_small_numbers_take_a_byte_each(tmp_path: Path, points: int) -> None:
    path = tmp_path / "short" / "drive.parquet"
    code = np.random.default_rng(0).integers(-128, 128, (points, 64), dtype=np.int8)
    write(path, ShortRow, [ShortRow("drive", 0, code)], stamp="{}", counts={})
    np.testing.assert_array_equal(Table(path, ShortRow)[0].code, code)
    assert path.stat().st_size < points * 64 + 2000
