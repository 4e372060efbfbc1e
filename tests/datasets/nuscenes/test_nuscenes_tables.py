"""Rows of large tables, found by key without holding the table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from upvl_cli.datasets.nuscenes.tables import KeyedTable
from upvl_cli.errors import BadInput


def test_rows_of_a_table_of_several_blocks_are_those_of_a_plain_reader(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    rows = [
        {
            "key": f"k{number % 1000}",
            "number": number,
            "note": 'é"{' * (number % 200),
            "list": [{"key": "k1"}],
        }
        for number in range(12_000)
    ]
    path.write_text(json.dumps(rows, indent=1, ensure_ascii=False), "utf-8")
    assert path.stat().st_size > 5 * 2**20, "more than one block"
    table = KeyedTable(path, "key")
    for keys in ({"k1"}, {"k0", "k999", "none"}, set(), {f"k{number}" for number in range(1000)}):
        assert table.rows(keys) == [row for row in rows if row["key"] in keys]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[",
        "{}",
        "[1]",
        "[[]]",
        '[{"key": "a"}',
        '[{"key": "a"',
        "null",
        "[" * 5000,
        '[{"key": 1}]',
        "[{}]",
    ],
)
def test_what_is_no_list_of_rows_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text(text)
    with pytest.raises(BadInput, match=r"table.json"):
        KeyedTable(path, "key").rows({"a"})


def test_a_row_without_end_is_refused_before_the_whole_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text('[{"key": "' + "a" * 2**23)
    with pytest.raises(BadInput, match="no whole list of rows"):
        KeyedTable(path, "key").rows({"a"})


def test_an_empty_table_has_no_row(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text(" [ ]\n")
    assert KeyedTable(path, "key").rows({"a"}) == []


def test_a_file_that_changed_since_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text('[{"key": "a"}]')
    table = KeyedTable(path, "key")
    assert len(table.rows({"a"})) == 1
    path.write_text("         ")
    with pytest.raises(BadInput, match="changed while it was read"):
        table.rows({"a"})
