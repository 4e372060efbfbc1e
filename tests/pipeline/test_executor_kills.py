"""Streets that are labelled while processes are killed at random moments: `bench/executor_kills.py`, smaller."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[2] / "bench" / "executor_kills.py"


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the serial run, which the first test makes."""
    return tmp_path_factory.mktemp("reference") / "serial"


@pytest.mark.slow
@pytest.mark.parametrize("on", ["processes", "shards", "slurm", "ray"])
def test_kills_change_no_byte_and_nothing_is_made_twice(on: str, reference: Path) -> None:
    pytest.importorskip("psutil")
    if on in ("slurm", "ray"):
        pytest.importorskip({"slurm": "submitit", "ray": "ray"}[on])
    options = ["--drives", "4", "--frames", "2", "--kills", "3", "--warm-s", "4", "--pause", "1", "3"]
    done = subprocess.run(
        [sys.executable, BENCH, "--on", on, *options, "--reference", reference],
        capture_output=True, text=True, timeout=1200,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
