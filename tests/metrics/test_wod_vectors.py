"""Our scores against the official tools' output, through the command that others run."""

from __future__ import annotations

import importlib.util
import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

BENCH = Path(__file__).parents[2] / "bench" / "wod_vectors.py"


def run(*files: Path) -> subprocess.CompletedProcess[str]:
    """The command in this process: starting it takes longer than its work."""
    spec = importlib.util.spec_from_file_location("wod_vectors", BENCH)
    assert spec is not None
    assert spec.loader is not None
    sys.modules[spec.name] = command = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(command)
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = command.main([str(file) for file in files])
    return subprocess.CompletedProcess([], code, out.getvalue(), err.getvalue())


def tiny() -> dict[str, Any]:
    """One car, found, in the layout of the vectors, with values as the official tools give them."""
    car = {"context": ["s"], "frame": [0], "type": [1], "box": [[10, 0, 1, 4, 2, 1.5, 0]], "id": ["a"]}
    gt = car | {"num_points": [9], "detection_difficulty": [0], "tracking_difficulty": [0], "speed": [[0, 0]]}
    pd = car | {"score": [0.5], "overlap_nlz": [False], "speed": [None]}
    rule = {
        "iou_thresholds": [0, 0.5, 0.5, 0.5, 0.5],
        "matcher": "TYPE_HUNGARIAN",
        "breakdowns": ["OBJECT_TYPE"],
    }
    detected = {"AP": 1.0, "tp": [1] * 51 + [0] * 50, "fp": [0] * 101}
    tracked = {"MOTA": 1, "MOTP": 0, "score_cutoff": 0, "num_objects_gt": 1}
    unfound = {"MOTA": 0, "score_cutoff": None}
    name = "OBJECT_TYPE_TYPE_{}_LEVEL_1"
    tracks = {name.format("VEHICLE"): tracked, name.format("SIGN"): unfound}
    return {
        "gt": gt,
        "pd": pd,
        "expected": {
            "detection": {"a": rule | {"result": {name.format("VEHICLE"): detected}}},
            "tracking": {"a": rule | {"result": tracks}},
        },
    }


@pytest.mark.real
def test_official_vectors(shared: Path) -> None:
    files = sorted(map(str, (shared / "wod" / "vectors").glob("*.json")))
    command = [sys.executable, str(BENCH), *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "compared 2144 results" in done.stdout
    assert ", 0 beyond 1e-06" in done.stdout


def test_equal_results(tmp_path: Path) -> None:
    (path := tmp_path / "tiny.json").write_text(json.dumps(tiny()))
    done = run(path, path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("compared 6 results (418 numbers): largest difference")


@pytest.mark.parametrize(
    ("section", "result", "field", "value"),
    [
        ("detection", "VEHICLE", "AP", 0.99999),
        ("detection", "VEHICLE", "tp", [1] * 50 + [0] * 51),
        ("tracking", "VEHICLE", "score_cutoff", None),
        ("tracking", "SIGN", "score_cutoff", 0),
    ],
)
def test_a_difference_is_told(tmp_path: Path, section: str, result: str, field: str, value: Any) -> None:
    vector = tiny()
    vector["expected"][section]["a"]["result"][f"OBJECT_TYPE_TYPE_{result}_LEVEL_1"][field] = value
    (path := tmp_path / "tiny.json").write_text(json.dumps(vector))
    done = run(path)
    assert done.returncode == 1
    assert f"{section}.a OBJECT_TYPE_TYPE_{result}_LEVEL_1 {field}: ours" in done.stdout
    assert ", 1 beyond 1e-06" in done.stdout


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v.pop("gt"), "the file has no gt"),
        (lambda v: v["pd"].pop("score"), "pd has no score"),
        (lambda v: v["pd"].update(score=[0.5, 0.6]), "arrays of different lengths"),
        (lambda v: v["pd"].update(box=[[0] * 6]), "boxes have shape"),
        (lambda v: v["gt"].update(type=["car"]), "invalid literal"),
        (lambda v: v["expected"].update(segmentation={}), "section segmentation is unknown"),
        (lambda v: v["expected"]["detection"]["a"].pop("matcher"), "detection.a has no matcher"),
        (lambda v: v["expected"]["detection"]["a"].update(breakdowns=["CAMERA"]), "CAMERA"),
        (lambda v: v["expected"]["detection"]["a"].update(score_cutoffs=[0.0]), "other score cut-offs"),
        (lambda v: v["expected"]["detection"]["a"].update(result={"X": {"AP": 1}}), "result X"),
    ],
)
def test_an_unknown_layout_is_one_line(tmp_path: Path, change: Any, message: str) -> None:
    vector = tiny()
    change(vector)
    (path := tmp_path / "tiny.json").write_text(json.dumps(vector))
    done = run(path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert message in done.stderr


def test_unreadable_files(tmp_path: Path) -> None:
    (path := tmp_path / "tiny.json").write_text("{")
    for file, message in ((path, "is not JSON"), (tmp_path / "none.json", "cannot be read: No such file")):
        done = run(file)
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
        assert message in done.stderr
    assert run().returncode == 2
