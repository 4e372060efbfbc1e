"""Whatever is wrong with the tables: one clear line, or all of it is read."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import open_door
from datasets.contract import read_everything
from datasets.damages import apply_damage, file_damages
from open_door import SEGMENT, write_open_door, write_table
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.parquet.dataset import ParquetDrives

FOLDERS = {
    "points": open_door.point_columns,
    "cameras": open_door.camera_columns,
    "images": open_door.image_columns,
    "labels": open_door.label_columns,
}
FILES = [f"{folder}/{SEGMENT}.parquet" for folder in FOLDERS]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_open_door(tmp_path_factory.mktemp("whole"))


def read(root: Path) -> str | None:
    return read_everything(
        lambda: ParquetDrives(root), lambda dataset: label_source("parquet", root, dataset)
    )


def test_the_whole_drive_is_read(whole: Path) -> None:
    assert read(whole) is None


@settings(max_examples=60, deadline=None)
@given(st.lists(file_damages(FILES), min_size=1, max_size=2))
def test_damaged_files(whole: Path, damages: list[tuple[Any, ...]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(shutil.copytree(whole, Path(folder) / "drives"))
        for damage in damages:
            apply_damage(root, damage)
        read(root)


NUMBERS = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.floats(width=64),
    st.floats(-100, 100),
    st.none(),
    st.integers(-3, 300),
)
CELLS = st.one_of(
    st.lists(NUMBERS, min_size=4, max_size=4),
    st.lists(st.one_of(st.none(), st.lists(NUMBERS, max_size=20)), min_size=4, max_size=4),
    st.lists(st.lists(st.floats(width=32), min_size=16, max_size=16), min_size=4, max_size=4),
    st.lists(st.text(max_size=12), min_size=4, max_size=4),
    st.lists(st.binary(max_size=12), min_size=4, max_size=4),
    st.lists(st.booleans(), min_size=4, max_size=4),
    st.lists(st.datetimes(), min_size=4, max_size=4),
    st.just([{"a": 1}] * 4),
    st.just([np.zeros((2, 2)).tolist()] * 4),
)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(list(FOLDERS)), st.data(), CELLS, st.sampled_from([1, 3, 100]))
def test_columns_of_other_types_and_values(
    whole: Path, folder: str, data: st.DataObject, cells: list[Any], row_group_size: int
) -> None:
    columns = FOLDERS[folder]()
    name = data.draw(st.sampled_from(list(columns)))
    rows = len(pa.array(columns[name]))
    try:
        columns[name] = pa.array(cells[:rows])
    except (pa.ArrowException, OverflowError):
        return  # no such column can be written
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(shutil.copytree(whole, Path(temporary) / "drives"))
        write_table(root / f"{folder}/{SEGMENT}.parquet", columns, row_group_size=row_group_size)
        read(root)
