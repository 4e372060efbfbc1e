"""Points, data frames and recordings for scripts."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import upvl_cli as upvl
from command import make_workspace, set_value
from drive_shards import (
    FEW_SWEEPS,
    SEGMENT,
    street_drive,
    street_labels,
    street_workspace,
    write_street_shards,
)
from tiny_kitti import write_drive
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.results.results import Results

FRAMES = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace of the street with tables of its first frames."""
    made = make_workspace(tmp_path_factory.mktemp("scripted"), **FEW_SWEEPS)
    write_street_shards(street_workspace(made), FRAMES)
    return made


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return upvl.open(folder / "out")


def test_points_come_with_what_was_made_of_them(results: Results) -> None:
    table = results.points(SEGMENT, 1)
    points, truth = street_drive().points_with_truth(1)
    xyz_m = np.column_stack([table.column(f"{axis}_m") for axis in "xyz"])
    np.testing.assert_array_equal(xyz_m, points.xyz_ego_m)
    flow_mps = np.column_stack([table.column(f"flow_{axis}_mps") for axis in "xyz"])
    np.testing.assert_allclose(flow_mps, truth.velocity_mps, atol=0.02)
    np.testing.assert_array_equal(table.column("is_ground"), truth.object_index < 0)
    np.testing.assert_allclose(table.column("intensity"), points.intensity)
    assert table.schema.field("flow_x_mps").metadata == {
        b"meaning": b"velocity over the ground", b"unit": b"m/s", b"axes": b"ego",
    }  # fmt: skip
    labels = street_labels(1)
    inside = points_inside(points.xyz_ego_m, labels.boxes, margin_m=0.0).any(axis=0)
    words = np.array(table.column("word").to_pylist(), dtype=object)
    assert set(words[inside]) <= {"car", "pedestrian"}
    assert {"height_m", "is_moving", "background"} <= set(table.column_names)


def test_points_of_a_frame_without_tables_are_the_sweep_alone(results: Results) -> None:
    assert results.points(SEGMENT, 10).column_names == ["x_m", "y_m", "z_m", "intensity"]


def test_what_has_no_points_is_named(results: Results, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match="street-0 has no frame 99: it has 0 to 19"):
        results.points(SEGMENT, 99)
    with pytest.raises(BadSetting, match="unknown segment 'street-1'; did you mean 'street-0'"):
        results.points("street-1", 0)
    lost = make_workspace(tmp_path, raw__dataset='"kitti"', raw__root='"nowhere"')
    (lost / "out").symlink_to(folder / "out")
    with pytest.raises(BadInput, match="street-0: no points and no pictures"):
        upvl.open(lost / "out").points(SEGMENT, 1)


def test_a_relative_root_is_found_beside_the_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = write_drive(tmp_path / "here" / "drives", frames=2)
    here = make_workspace(tmp_path / "here", raw__dataset='"kitti"')
    set_value(here, "raw", "root", json.dumps("drives"))
    name = drive.folder.name
    (here / "out" / "labels").mkdir(parents=True)
    (here / "out" / "labels" / f"{name}.parquet").touch()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert upvl.open("../here/out").workspace.segments == (name,)


def test_labels_become_a_data_frame(results: Results) -> None:
    pytest.importorskip("pandas")
    frame = results.to_pandas()
    assert frame["class"].tolist() == ["vehicle", "pedestrian"]
    assert results.to_pandas(SEGMENT).equals(frame)
    assert results.segments == (SEGMENT,)


def test_missing_pandas_is_named(folder: Path) -> None:
    program = (
        "import sys; sys.modules['pandas'] = None; import upvl_cli as upvl; from upvl_cli.errors import BadSetting\n"
        "try: upvl.open('out').to_pandas()\nexcept BadSetting as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True)
    assert done.stdout == "to_pandas needs the package pandas; run: pip install pandas\n", done.stderr


def test_a_drive_becomes_a_recording(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rerun")
    path = results.to_rerun(tmp_path / "street.rrd", frame_range=(1, 1))
    assert path == tmp_path / "street.rrd" and path.stat().st_size > 100_000
    with pytest.raises(BadSetting, match="does not end in .rrd"):
        results.to_rerun(tmp_path / "street.txt")
    if sys.platform.startswith("linux"):
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        with pytest.raises(BadSetting, match="there is no display for a window; name a file"):
            results.to_rerun()
