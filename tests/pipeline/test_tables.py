"""Shards are whole or absent, the same bytes twice, and give back what was put in."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar

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


@dataclass(frozen=True)
class BoxesRow(Row):
    per_box: ClassVar[bool] = True

    time_ns: int = column("int64", "time")
    center_m: Array = column("float64", "center", per="box", names=("x_m", "y_m"))


def boxes(frame: int, total: int) -> BoxesRow:
    return BoxesRow("drive", frame, 10 * frame, np.arange(total * 2.0).reshape(total, 2) + frame)


def thing(frame: int, points: int) -> ThingRow:
    flow = (np.arange(points * 3, dtype=np.float32) % 2048).reshape(points, 3)
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


def groups_of(path: Path) -> list[int]:
    """How many rows of the table each row group has."""
    metadata = pa.parquet.read_metadata(path)
    return [metadata.row_group(number).num_rows for number in range(metadata.num_row_groups)]


def test_frames_share_row_groups_and_large_ones_do_not(tmp_path: Path) -> None:
    """Whoever opens a shard holds its footer: with a row group a frame it would grow with the drive."""
    save(tmp_path / "small.parquet", *(thing(frame, 3) for frame in range(150)))
    assert groups_of(tmp_path / "small.parquet") == [64, 64, 22]
    points = tables.GROUP_BYTES // 6  # three numbers of two bytes each
    save(tmp_path / "large.parquet", *(thing(frame, points // 2 + 10) for frame in range(5)))
    assert groups_of(tmp_path / "large.parquet") == [2, 2, 1]


@pytest.mark.parametrize("kind", [ThingRow, BoxesRow])
def test_any_frame_is_found_in_any_order(tmp_path: Path, kind: type[Row]) -> None:
    make = thing if kind is ThingRow else boxes
    rows = [make(7 * number, number % 4) for number in range(50)]
    write(tmp_path / "drive.parquet", kind, rows, stamp="{}", counts={})
    table = Table(tmp_path / "drive.parquet", kind)
    assert [row.frame for row in table] == list(table.frames) == [row.frame for row in rows]
    for number in np.random.default_rng(0).permutation(50):
        found, expected = table[7 * number], rows[number]
        for spec in fields(kind):
            np.testing.assert_array_equal(getattr(found, spec.name), getattr(expected, spec.name))
    for missing in (-1, 1, 350):
        with pytest.raises(KeyError):
            table[missing]


def test_a_shard_with_a_row_group_a_frame_is_read_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "GROUP_FRAMES", 1)
    save(tmp_path / "drive.parquet", *(thing(frame, frame) for frame in range(5)))
    assert groups_of(tmp_path / "drive.parquet") == [1] * 5
    assert [len(row.is_far) for row in Table(tmp_path / "drive.parquet", ThingRow)] == list(range(5))


def test_other_values_have_another_footer_though_bounds_and_sizes_are_the_same(tmp_path: Path) -> None:
    """A stamp holds the digest of the footers of what was read."""
    for name, order in (("a", [0, 1, 2, 3]), ("b", [0, 2, 1, 3])):
        row = replace(thing(1, 4), flow_mps=np.array(order, np.float16)[:, None] + np.zeros(3, np.float16))
        save(tmp_path / f"{name}.parquet", row)
    assert tables.footer_digest(tmp_path / "a.parquet") != tables.footer_digest(tmp_path / "b.parquet")
    save(tmp_path / "c.parquet", replace(row))
    assert tables.footer_digest(tmp_path / "c.parquet") == tables.footer_digest(tmp_path / "b.parquet")


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
