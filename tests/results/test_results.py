"""The results of a workspace as tables, by the package and by other tools."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import upvl_cli as upvl
from made_labels import box_columns, label_row
from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.pipeline.tables import write
from upvl_cli.stages.rows import FlowRow, LabelRow, ObjectRow, TrackRow
from upvl_cli.stages.shared_columns import without_looks
from upvl_cli.types import Ragged

# Of each drive the boxes of its two frames: their class and length.
BOXES = {
    "drive-a": ([("vehicle", 4.0), ("pedestrian", 0.5)], [("vehicle", 5.0)]),
    "drive-b": ([], [("vehicle", 9.0), ("unknown", 1.0)]),
}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder of results of two drives; no workspace is around it."""
    folder = tmp_path / "out"
    for segment, frames in BOXES.items():
        rows = [label_row(segment, frame, boxes) for frame, boxes in enumerate(frames)]
        write(folder / "labels" / f"{segment}.parquet", LabelRow, rows, stamp="{}", counts={})
    return folder


def test_labels_of_one_drive_and_of_all(out: Path) -> None:
    results = upvl.open(out)
    one = results.labels("drive-a").to_pydict()
    assert one["class"] == ["vehicle", "pedestrian", "vehicle"]
    assert one["segment"] == ["drive-a"] * 3
    assert one["frame"] == [0, 0, 1]
    assert one["time_ns"] == [0, 0, 10**8]
    assert one["length_m"] == [4.0, 0.5, 5.0]
    assert one["center_y_m"] == [1.0, 4.0, 1.0]
    every = results.labels().to_pydict()
    assert every["segment"] == ["drive-a"] * 3 + ["drive-b"] * 2
    assert every["length_m"] == [4.0, 0.5, 5.0, 9.0, 1.0]


def test_labels_name_their_units(out: Path) -> None:
    assert upvl.open(str(out)).labels().schema.field("length_m").metadata[b"unit"] == b"m"


def test_detections_come_without_the_features_of_their_points(out: Path) -> None:
    boxes = [("vehicle", 4.0)]
    row = ObjectRow(
        "drive-a", 0, time_ns=5, **box_columns(boxes), score=np.array([0.75]), track_id=np.array([-1]),
        num_features=np.array([2]), pooled=np.zeros((1, 64), np.int8),
        point_feature=Ragged(np.zeros((2, 64), np.int8), np.array([2])), **without_looks(1),
    )  # fmt: skip
    write(out / "detect/drive-a.parquet", ObjectRow, [row], stamp="{}", counts={})
    table = upvl.open(out).detections()
    assert table.column("score").to_pylist() == [0.75]
    assert not {"pooled", "point_feature"} & set(table.column_names)


def test_tracks_and_flow(out: Path) -> None:
    boxes = [("", 4.0)]
    row = TrackRow(
        "drive-a",
        0,
        time_ns=5,
        **box_columns(boxes),
        track_id=np.array([3]),
        proposal=np.array([0]),
        hypothesis=np.array([0]),
    )
    write(out / "track/drive-a.parquet", TrackRow, [row], stamp="{}", counts={})
    flow = FlowRow("drive-a", 4, np.array([[1.0, 0, 0], [0, 2.0, 0]]))
    write(out / "flow/drive-a.parquet", FlowRow, [flow], stamp="{}", counts={})
    results = upvl.open(out)
    assert results.tracks("drive-a").column("track_id").to_pylist() == [3]
    found = results.flow("drive-a")
    assert found.column("frame").to_pylist() == [4]
    assert found.column("flow_mps").to_pylist() == [[1, 0, 0, 0, 2, 0]]


def test_what_is_not_there_is_named(out: Path) -> None:
    with pytest.raises(BadSetting, match="nowhere is no folder"):
        upvl.open(out / "nowhere")
    with pytest.raises(BadSetting, match="holds no results of upvl; expected for example .*labels"):
        upvl.open(out.parent)
    results = upvl.open(out)
    with pytest.raises(
        BadSetting, match="no segment 'drive-bb'; did you mean 'drive-b'.*it has drive-a, drive-b"
    ):
        results.labels("drive-bb")
    with pytest.raises(NotMade, match="detect has no file; run: upvl train"):
        results.detections()
    (out / "labels/drive-b.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(NotMade, match=r"drive-b.parquet is damaged"):
        results.labels()


def test_pyarrow_counts_the_classes(out: Path) -> None:
    groups = upvl.open(out).labels().group_by("class").aggregate([([], "count_all"), ("length_m", "mean")])
    found = {row["class"]: (row["count_all"], row["length_m_mean"]) for row in groups.to_pylist()}
    assert found == {"vehicle": (3, 6.0), "pedestrian": (1, 0.5), "unknown": (1, 1.0)}


def test_duckdb_counts_the_classes(out: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    sql = f"select class, count(*), avg(length_m) from '{out}/labels/*.parquet' group by 1"
    assert set(duckdb.sql(sql).fetchall()) == {
        ("vehicle", 3, 6.0),
        ("pedestrian", 1, 0.5),
        ("unknown", 1, 1.0),
    }


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = (
        "import sys; before = set(sys.modules); import upvl_cli; "
        "print(sorted({name.split('.')[0] for name in set(sys.modules) - before} & {'numpy', 'pyarrow', 'typer', "
        "'pydantic', 'torch', 'scipy', 'importlib.metadata'})); print(upvl_cli.__version__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded, version = done.stdout.splitlines()
    assert loaded == "[]"
    assert version[0].isdigit()
    with pytest.raises(AttributeError, match="no attribute 'opne'"):
        upvl.opne  # noqa: B018
