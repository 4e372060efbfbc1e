"""Whatever is wrong with the files of a segment: one clear line, or all of it is read."""

from __future__ import annotations

import shutil
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.contract import assert_one_line, read_everything
from datasets.damages import apply_damage, file_damages
from tiny_waymo import (
    SEGMENT,
    block,
    record,
    tiny_segment,
    v2_columns,
    varint,
    whole,
    write_component,
    write_v1,
    write_v2,
)
from upvl_cli.datasets.waymo.dataset import Waymo
from upvl_cli.datasets.waymo.labels import WaymoLabels
from upvl_cli.errors import BadInput

EXAMPLES = 40
COMPONENTS = list(v2_columns(tiny_segment(1)))
V2_FILES = [f"{component}/{SEGMENT}.parquet" for component in COMPONENTS]
V1_FILE = f"segment-{SEGMENT}_with_camera_labels.tfrecord"


@pytest.fixture(scope="module")
def v2(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_v2(tmp_path_factory.mktemp("v2"), tiny_segment())


@pytest.fixture(scope="module")
def v1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_v1(tmp_path_factory.mktemp("v1"), tiny_segment(2), zones=[np.eye(3)[:, :2]]).parent


def read(root: Path) -> str | None:
    """Read everything: points, pictures, labels, and then pixels and zones."""
    said = read_everything(lambda: Waymo(root), lambda dataset: WaymoLabels(root))
    try:
        waymo = Waymo(root)
        for segment in waymo.segments:
            drive = waymo.open(segment)
            for frame in drive.frames:
                for camera in drive.cameras:
                    drive.pixels(frame.index, camera.name)
                labels = WaymoLabels(root).labels(segment)
                WaymoLabels(root).unlabelled(segment, frame.index, labels)
    except BadInput as error:
        assert_one_line(error)
    return said


def test_whole_segments_are_read(v1: Path, v2: Path) -> None:
    assert read(v1) is None and read(v2) is None


@settings(max_examples=EXAMPLES)
@given(st.lists(file_damages(V2_FILES), min_size=1, max_size=2))
def test_damaged_components(v2: Path, damages: list[tuple[Any, ...]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(shutil.copytree(v2, Path(folder) / "drives"))
        for damage in damages:
            apply_damage(root, damage)
        read(root)


@settings(max_examples=EXAMPLES)
@given(st.lists(file_damages([V1_FILE]), min_size=1, max_size=3))
def test_damaged_records(v1: Path, damages: list[tuple[Any, ...]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(shutil.copytree(v1, Path(folder) / "drives"))
        for damage in damages:
            apply_damage(root, damage)
        read(root)


NUMBERS = st.one_of(st.integers(-(2**63), 2**63 - 1), st.floats(width=64), st.none(), st.integers(-3, 300))
CELL = st.one_of(
    NUMBERS,
    st.lists(NUMBERS, max_size=20),
    st.lists(st.floats(width=32), min_size=16, max_size=16),
    st.lists(st.integers(-5, 2**31), min_size=3, max_size=3),
    st.text(max_size=12),
    st.binary(max_size=12),
    st.booleans(),
    st.datetimes(),
    st.just({"a": 1}),
)


@settings(max_examples=EXAMPLES)
@given(st.sampled_from(COMPONENTS), st.data(), CELL, st.booleans(), st.sampled_from([1, 3, 100]))
def test_columns_of_other_types_and_values(
    v2: Path, component: str, data: st.DataObject, cell: Any, everywhere: bool, rows_per_group: int
) -> None:
    columns = v2_columns(tiny_segment())[component]
    name = data.draw(st.sampled_from(list(columns)))
    old = columns[name].to_pylist() if isinstance(columns[name], pa.Array) else columns[name]
    cells = [cell] * len(old) if everywhere else [cell, *old[1:]]
    try:
        columns[name] = pa.array(cells)
    except (pa.ArrowException, OverflowError):
        return  # no such column can be written
    with tempfile.TemporaryDirectory() as folder:
        root = Path(shutil.copytree(v2, Path(folder) / "drives"))
        write_component(root, component, columns, rows_per_group=rows_per_group)
        read(root)


@settings(max_examples=EXAMPLES)
@given(st.integers(1, 13), st.one_of(st.binary(max_size=30), st.integers(0, 2**64 - 1)), st.integers(1, 8))
def test_records_with_fields_of_other_kinds(v1: Path, number: int, content: Any, inner: int) -> None:
    """A message whose checksums are right, and a field is not."""
    field = whole(number, content) if isinstance(content, int) else block(number, content)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / V1_FILE
        old = (v1 / V1_FILE).read_bytes()
        length = int.from_bytes(old[:8], "little")
        message = old[12 : 12 + length]
        path.write_bytes(record(message + field) + record(message + block(inner, field))[:])
        read(Path(folder))
        path.write_bytes(record(message + block(inner, field)))
        read(Path(folder))


def test_a_stream_that_fills_the_memory_is_refused(tmp_path: Path) -> None:
    frames = tiny_segment(1)
    path = write_v1(tmp_path, frames)
    content = path.read_bytes()
    message = content[12:-4]
    bomb = zlib.compress(bytes(200_000_000), 1)
    path.write_bytes(record(message + block(5, whole(1, 2) + block(2, block(2, bomb)))))
    with pytest.raises(BadInput, match="cut off, or larger than"):
        Waymo(tmp_path).open(SEGMENT).points(0)


def test_an_endless_number_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.tfrecord").write_bytes(record(b"\x10" + b"\xff" * 30 + b"\x00"))
    with pytest.raises(BadInput, match="is damaged"):
        Waymo(tmp_path).open("a")
    assert varint(300) == b"\xac\x02"
