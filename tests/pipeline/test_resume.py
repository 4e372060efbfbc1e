"""A run that is killed at any moment resumes, and ends with the same bytes as an undisturbed one."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from command import UPVL, make_workspace, upvl
from upvl_cli.commands.pipeline import PIPELINE

KILLS = 5


def shards(workspace: Path) -> dict[str, bytes]:
    return {path.parent.name: path.read_bytes() for path in sorted(workspace.glob("out/*/*.parquet"))}


@pytest.mark.slow
def test_killed_at_random_moments(tmp_path: Path) -> None:
    whole = make_workspace(tmp_path / "whole")
    started = time.perf_counter()
    assert upvl(whole, "autolabel", "--moving-only").returncode == 0
    undisturbed_s = time.perf_counter() - started

    killed = make_workspace(tmp_path / "killed")
    moments = random.Random(4)
    for _ in range(KILLS):
        process = subprocess.Popen([UPVL, "autolabel", "--moving-only"], cwd=killed, start_new_session=True)
        time.sleep(moments.uniform(0.2, 1.0) * undisturbed_s / 2)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert upvl(killed, "autolabel", "--moving-only").returncode == 0
    assert shards(killed) == shards(whole)
    assert len(shards(whole)) == len(PIPELINE.labelling_stages)
    assert not list(killed.glob("out/**/.*.part"))
