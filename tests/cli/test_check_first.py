"""A drive is checked before it is labelled, by autolabel and by make; a fault stops both."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from command import ENVIRONMENT, ROOT, UPVL, fails, make_workspace, of_streets, upvl


@pytest.fixture(scope="module")
def feet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace whose drive is in feet."""
    folder = make_workspace(tmp_path_factory.mktemp("feet"), **of_streets(1, frames=8))
    with (folder / "stages" / "raw.toml").open("a") as file:
        file.write("\n[corrections]\nmetres_per_unit = 3.28\n")
    return folder


def test_a_fault_stops_autolabel_before_anything_is_made(feet: Path) -> None:
    done = upvl(feet, "autolabel", "--moving-only")
    assert done.returncode == 2
    assert "fault: street-0: " in done.stderr
    assert done.stderr.splitlines()[-1].endswith("see: upvl check street-0; to go on all the same: --anyway")
    assert "feet" in done.stderr
    assert "metres_per_unit = 0.3048" in done.stderr
    assert not list(feet.glob("out/*/*.parquet"))


def test_make_asks_the_same(feet: Path) -> None:
    (feet / "Makefile").write_text((ROOT / "workspace.mk").read_text())
    command = ["make", f"UPVL_COMMAND={UPVL}", "ground"]
    done = subprocess.run(command, cwd=feet, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2
    assert "to go on all the same: --anyway" in done.stderr
    assert not list(feet.glob("out/*/*.parquet"))
    command = [*command, "ANYWAY=--anyway"]
    done = subprocess.run(command, cwd=feet, env=ENVIRONMENT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert {path.parent.name for path in feet.glob("out/*/*.parquet")} == {"odometry", "ground"}


def test_check_prints_lines_or_json(feet: Path) -> None:
    lines = upvl(feet, "check", "--quick", "--anyway").stdout.splitlines()
    assert lines[0] == "street-0"
    assert any(line.startswith("  fault: units: ") for line in lines)
    (report,) = json.loads(upvl(feet, "check", "--quick", "--anyway", "--json").stdout)
    assert report["segment"] == "street-0"
    assert report["level"] == "fault"
    assert {"units"} <= {found["subject"] for found in report["findings"] if found["level"] == "fault"}


def test_a_sound_drive_has_no_fault_and_no_warning(tmp_path: Path) -> None:
    done = upvl(make_workspace(tmp_path), "check", "--quick", "--json")
    assert done.returncode == 0, done.stderr
    (report,) = json.loads(done.stdout)
    assert report["level"] in ("ok", "cannot tell"), report


def test_an_unknown_drive_is_named(tmp_path: Path) -> None:
    assert "unknown segment 'street-9'; did you mean 'street-0'?" in fails(
        make_workspace(tmp_path), "check", "street-9"
    )
