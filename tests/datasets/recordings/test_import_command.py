"""`upvl import` whole, as a person runs it."""

from __future__ import annotations

from pathlib import Path

import pytest

from command import fails, upvl
from datasets.recordings.street import write_scans, write_tum

pytestmark = pytest.mark.xdist_group("cli")


def test_from_a_folder_to_a_drive(tmp_path: Path) -> None:
    write_scans(tmp_path / "scans", names="time")
    write_tum(tmp_path / "poses.tum", [0, 1, 2, 3])
    done = upvl(tmp_path, "import", "scans", "drives", "--poses", "poses.tum")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        "4 files like 1532402927.647951000.pcd",
        "times from the names of the files",
        "poses from poses.tum (TUM), by time",
        "PCD binary with x, y, z, intensity: intensity 0 to 255, no times of points",
        "scans: 4 sweeps, 1600 points",
        "",
        "in stages/raw.toml:",
        'dataset = "parquet"',
        f'root = "{tmp_path / "drives"}"',
        "segments = []",
        "",
        "then: upvl autolabel --moving-only && upvl draw",
    ]
    again = upvl(tmp_path, "import", "scans", "drives", "--poses", "poses.tum")
    assert again.stdout.startswith("scans: there already, of the same files and settings\n")


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    write_scans(tmp_path / "scans")
    assert "scans is not there" not in fails(tmp_path, "import", "scans", "drives")
    assert "elsewhere is not there" in fails(tmp_path, "import", "elsewhere", "drives")
    assert "--segment" in fails(tmp_path, "import", "scans", "drives", "--rate-hz", "10", "--segment", "../x")
    assert not (tmp_path / "drives").exists()
