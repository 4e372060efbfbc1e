"""Points as LAS and PLY: each field by hand, what is missing is told, and other readers open them."""

from __future__ import annotations

import builtins
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from command import make_workspace
from export.one_car import FRAME, PointDrive, car, drive_of_one_car, write
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.datasets.shared.point_files.read import read_points
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.export.drive import ExportDrive
from upvl_cli.export.las_points import read_las_columns
from upvl_cli.export.ply_points import ply_content, read_ply_columns
from upvl_cli.export.point_tables import PointTables
from upvl_cli.pipeline.tables import write as write_shard
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import SemanticsRow
from upvl_cli.stages.rows import FlowRow, GroundRow, MaskRow
from upvl_cli.types import Array, concat

READERS: dict[str, Callable[[Path], dict[str, Array]]] = {"las": read_las_columns, "ply": read_ply_columns}
NAMES = np.array(["road", "car"])
COLUMNS: dict[str, Array] = {
    "height_m": np.array([1.0, 0.75, 0.0], np.float16),
    "is_ground": np.array([False, False, True]),
    "flow_mps": np.array([[0.0, 3, 0], [0, 3, 0], [0, 0, 0]], np.float16),
    "is_moving": np.array([True, True, False]),
    "class_name": NAMES,
    "class_index": np.array([1, -1, 0], np.int8),
}


def drive_with_points(columns: Mapping[str, Array] | None = COLUMNS, **changes: object) -> ExportDrive:
    found = None if columns is None else (lambda frame: dict(columns))
    return replace(drive_of_one_car(**changes), source=PointDrive(), point_columns=found)


@pytest.mark.parametrize("name", list(READERS))
def test_each_field_of_three_points(name: str, tmp_path: Path) -> None:
    """The first two points lie in the car; the third is road."""
    told = write(drive_with_points(), name, tmp_path)
    found = READERS[name](tmp_path / "one" / f"0000000007.{name}")
    xyz = np.column_stack([found[axis] for axis in "xyz"])
    np.testing.assert_allclose(xyz, PointDrive.xyz_ego_m, atol=0.0006)  # LAS has millimetres
    np.testing.assert_allclose(found["intensity"], [0, 0.5, 1], atol=1e-5)
    assert found["height"].tolist() == [1.0, 0.75, 0.0] and found["is_ground"].tolist() == [0, 0, 1]
    assert [found[axis].tolist() for axis in ("vx", "vy", "vz")] == [[0, 0, 0], [3, 3, 0], [0, 0, 0]]
    assert found["is_moving"].tolist() == [1, 1, 0]
    assert found["word"].tolist() == [1, -1, 0]
    assert found["track_id"].tolist() == [12, 12, -1] and found["class"].tolist() == [0, 0, -1]
    assert (tmp_path / "words.csv").read_text() == "number,name\n0,road\n1,car\n"
    assert (tmp_path / "classes.csv").read_text() == "number,name\n0,car\n"
    assert not [reason for reason in told if "table" in reason]


@pytest.mark.parametrize("name", list(READERS))
def test_world_axes_turn_places_and_flow(name: str, tmp_path: Path) -> None:
    """The ego stands at (100, 200, 5) and looks along the world's y."""
    write(drive_with_points(), name, tmp_path, world_axes=True)
    found = READERS[name](tmp_path / "one" / f"0000000007.{name}")
    xyz = np.column_stack([found[axis] for axis in "xyz"])
    np.testing.assert_allclose(xyz[0], [98, 210, 5.5], atol=0.0006)
    np.testing.assert_allclose([found[axis][0] for axis in ("vx", "vy", "vz")], [-3, 0, 0], atol=1e-6)
    assert found["track_id"].tolist() == [12, 12, -1]


@pytest.mark.parametrize("name", list(READERS))
def test_what_was_not_made_is_left_out_and_told(name: str, tmp_path: Path) -> None:
    some = {key: COLUMNS[key] for key in ("height_m", "is_ground")}
    told = write(drive_with_points(some), name, tmp_path / "some")
    found = READERS[name](tmp_path / "some" / "one" / f"0000000007.{name}")
    assert "height" in found and not {"vx", "is_moving", "word"} & set(found)
    assert (
        told["drives without the table semantics: their points have no word; make it with: upvl semantics"]
        == 1
    )
    assert told[
        "drives without the table flow: their points have no flow (vx, vy, vz); make it with: upvl flow"
    ]
    assert not [reason for reason in told if "table ground" in reason]
    told = write(drive_of_one_car(), name, tmp_path / "none")
    assert told["drives whose files cannot be read: no points of them are written"] == 1


def test_where_boxes_overlap_a_point_is_of_the_surest(tmp_path: Path) -> None:
    second = car(track_id=[13], score=[0.5], class_name=["bus"], size_lwh_m=[[12.0, 9, 4]])
    boxes = concat([car(), second], type(second))
    write(drive_with_points().with_boxes(boxes), "ply", tmp_path)
    assert read_ply_columns(tmp_path / "one" / "0000000007.ply")["track_id"].tolist() == [12, 12, -1]


def test_other_readers_open_them(tmp_path: Path) -> None:
    write(drive_with_points(), "ply", tmp_path / "ply")
    scan = read_points(tmp_path / "ply" / "one" / "0000000007.ply")
    np.testing.assert_array_equal(scan.xyz_m, PointDrive.xyz_ego_m.astype(np.float32))
    laspy = pytest.importorskip("laspy")
    write(drive_with_points(), "las", tmp_path / "las")
    las = laspy.read(tmp_path / "las" / "one" / "0000000007.las")
    assert str(las.header.version) == "1.4" and las.header.creation_date == date(1970, 1, 1)
    assert np.asarray(las.classification).tolist() == [1, 1, 2]  # unclassified, unclassified, ground
    assert np.asarray(las.intensity).tolist() == [0, 32768, 65535]


@pytest.mark.parametrize("name", list(READERS))
def test_the_same_points_give_the_same_bytes(name: str, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write(drive_with_points(), name, tmp_path / folder)
    path = Path("one") / f"0000000007.{name}"
    assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()


@pytest.mark.parametrize("name", list(READERS))
def test_a_sweep_without_points_is_a_file(name: str, tmp_path: Path) -> None:
    class Empty(PointDrive):
        def points(self, frame: int) -> object:
            return super().points(frame)[:0]

    drive = replace(drive_with_points(None), source=Empty())
    write(drive, name, tmp_path)
    assert all(len(values) == 0 for values in READERS[name](tmp_path / "one" / f"0000000007.{name}").values())


def test_a_table_of_another_sweep_is_refused(tmp_path: Path) -> None:
    columns = COLUMNS | {"is_moving": np.array([True])}
    with pytest.raises(
        BadInput, match="is_moving of frame 7 of one has 1 values for 3 points; make the tables"
    ):
        write(drive_with_points(columns), "ply", tmp_path)


def test_without_laspy_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def refuse(name: str, *rest: object, **more: object) -> object:
        if name == "laspy":
            raise ImportError(name)
        return original(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(BadSetting, match=r"las needs the package laspy; run: pip install 'upvl\[las\]'"):
        write(drive_of_one_car(), "las", tmp_path)


def test_the_tables_of_a_workspace_give_the_columns(tmp_path: Path) -> None:
    workspace = Workspace(PIPELINE, make_workspace(tmp_path) / "stages", tmp_path / "out")
    rows = {
        "ground": GroundRow("one", FRAME, COLUMNS["height_m"], COLUMNS["is_ground"]),
        "flow": FlowRow("one", FRAME, COLUMNS["flow_mps"]),
        "mask": MaskRow("one", FRAME, COLUMNS["is_moving"], np.array([0, 0, 1], np.int8)),
    }
    assert PointTables(workspace, "one")(FRAME) == {}
    for stage, row in rows.items():
        write_shard(workspace.shard(stage, "one"), type(row), [row], stamp="{}", counts={})
    found = PointTables(workspace, "one")(FRAME)
    assert list(found) == ["height_m", "is_ground", "flow_mps", "is_moving"]
    for name, values in found.items():
        np.testing.assert_array_equal(values, COLUMNS[name])
    numbers = COLUMNS["class_index"]
    word = SemanticsRow("one", FRAME, NAMES, numbers, np.ones(3, np.int16), np.ones(3, np.float16))
    write_shard(workspace.shard("semantics", "one"), SemanticsRow, [word], stamp="{}", counts={})
    tables = PointTables(workspace, "one")
    assert tables(FRAME)["class_name"].tolist() == ["road", "car"]
    assert tables(FRAME + 1) == {}  # a frame that the tables have not


def test_a_header_lists_types_and_words() -> None:
    content = ply_content({"x": np.zeros(1, np.float64), "word": np.zeros(1, np.int16)}, ["word 0 road"])
    assert content == (
        b"ply\nformat binary_little_endian 1.0\ncomment word 0 road\nelement vertex 1\nproperty double x\n"
        b"property short word\nend_header\n" + bytes(10)
    )
