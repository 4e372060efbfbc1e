"""A SLURM array, through submitit's executor of this machine: shares that are killed are submitted again."""

from __future__ import annotations

import signal
import stat
import subprocess
import time
from pathlib import Path

import pytest

from command import ENVIRONMENT, UPVL, fails, make_workspace, upvl
from tiny_kitti import write_drive
from upvl_cli.errors import BadSetting
from upvl_cli.pipeline.executors.choose import without_place
from upvl_cli.pipeline.executors.slurm_options import SlurmOptions, array_script

pytest.importorskip("submitit")


def test_options_are_parsed_and_follow_from_the_stages() -> None:
    found = SlurmOptions.parse("partition=gpu, account=lab,time=120,memory=8,cpus=2,gpus=1,tasks=4")
    assert found == SlurmOptions("gpu", "lab", "", 120, 8, 2, 1, 4)
    assert SlurmOptions.parse("") == SlurmOptions()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("partion=gpu", "--slurm 'partion=gpu': expected NAME=VALUE with .*; did you mean partition?"),
        ("time=2h", "--slurm 'time=2h': expected time= and a whole number"),
        ("partition", "--slurm 'partition': expected partition= and a name"),
        ("partition=", "--slurm 'partition=': expected partition= and a name"),
        ("tasks=0", "expected tasks and time of at least 1"),
    ],
)
def test_what_is_no_option_is_one_clear_line(text: str, message: str) -> None:
    with pytest.raises(BadSetting, match=message):
        SlurmOptions.parse(text)


def test_words_that_say_where_are_left_out_of_a_command() -> None:
    words = [
        "--out",
        "o",
        "detect",
        "--on",
        "labels",
        "--on",
        "slurm",
        "--slurm=time=3",
        "--dry-run",
        "-s",
        "a",
    ]
    assert without_place(words) == ("--out", "o", "detect", "--on", "labels", "-s", "a")
    assert without_place(["flow", "--on=slurm:local", "--slurm", "tasks=2"]) == ("flow",)


def test_the_script_has_the_exact_command() -> None:
    options = SlurmOptions("gpu", "", "", 120, 4, 2, 1, 8)
    script = array_script(options, ["--out", "my out", "autolabel", "--moving-only"], Path("/w s"))
    assert script.splitlines() == [
        "#!/bin/bash",
        "#SBATCH --job-name=upvl",
        "#SBATCH --array=1-8",
        "#SBATCH --cpus-per-task=2",
        "#SBATCH --mem=4G",
        "#SBATCH --time=120",
        "#SBATCH --gpus-per-node=1",
        "#SBATCH --partition=gpu",
        "#SBATCH --output=upvl-%A_%a.log",
        "#SBATCH --open-mode=append",
        "",
        "cd '/w s'",
        "export UPVL_THREADS=$SLURM_CPUS_PER_TASK",
        "upvl --out 'my out' autolabel --moving-only --shard $SLURM_ARRAY_TASK_ID/8",
    ]


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace of three drives, the second of which cannot be read."""
    drives = [write_drive(tmp_path / "drives", drive=number) for number in (1, 2, 3)]
    (drives[1].folder / "velodyne_points" / "data" / "0000000001.bin").write_bytes(b"")
    return make_workspace(tmp_path / "w", raw__dataset='"kitti"', raw__root=f'"{drives[0].root}"')


def test_what_cannot_be_done_is_one_line(workspace: Path) -> None:
    assert "this machine has no sbatch" in fails(workspace, "odometry", "--on", "slurm")
    assert "a queue makes shares of its own" in fails(
        workspace, "odometry", "--on", "slurm:local", "--shard", "1/2"
    )
    assert "--slurm time=3: goes with --on slurm" in fails(workspace, "odometry", "--slurm", "time=3")
    assert "expected slurm, or slurm:local" in fails(workspace, "odometry", "--on", "slurm:here")
    printed = upvl(workspace, "odometry", "--on", "slurm", "--dry-run").stdout
    assert printed.endswith("\nupvl odometry --shard $SLURM_ARRAY_TASK_ID/3\n")
    assert not (workspace / "out" / "slurm").exists()


def test_shards_of_a_command(workspace: Path) -> None:
    first = upvl(workspace, "boxes2d", "--shard", "1/2")
    assert [line.split()[2] for line in first.stdout.splitlines()] == [
        "segment=2011_09_26_drive_0001_sync", "segment=2011_09_26_drive_0003_sync"
    ]  # fmt: skip
    last = upvl(workspace, "boxes2d", "--shard", "4/4")
    assert (last.returncode, last.stdout) == (
        0, "--shard 4/4: there are fewer drives than shares, and none is left for this one\n"
    )  # fmt: skip
    assert "--shard '0/64': expected I/N" in fails(workspace, "boxes2d", "--shard", "0/64")


@pytest.mark.slow
def test_an_array_on_this_machine(workspace: Path) -> None:
    on_queue = ("--on", "slurm:local", "--slurm", "tasks=2")
    line = upvl(workspace, "ground", *on_queue).stderr
    assert "3 of 3 drives failed" in line  # its input is not there
    assert "ground needs out/odometry/2011_09_26_drive_0001_sync.parquet" in line
    failed = upvl(workspace, "odometry", *on_queue)
    assert failed.returncode == 2
    (line,) = failed.stderr.splitlines()
    assert "1 of 3 drives failed" in line
    assert "0000000001.bin" in line
    made = [path.stem for path in sorted((workspace / "out" / "odometry").glob("*.parquet"))]
    assert made == ["2011_09_26_drive_0001_sync", "2011_09_26_drive_0003_sync"]
    assert stat.S_IMODE((workspace / "out" / "slurm").stat().st_mode) == 0o700


@pytest.mark.slow
def test_a_killed_task_is_submitted_again(workspace: Path) -> None:
    process = subprocess.Popen(
        [UPVL, "odometry", "--on", "slurm:local", "-s", "2011_09_26_drive_0001_sync"],
        cwd=workspace, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    psutil = pytest.importorskip("psutil")
    killed = False
    for _ in range(600):
        for child in psutil.Process(process.pid).children(recursive=True):
            with_words = child.cmdline() if child.is_running() else []
            if "upvl_cli" in with_words and not killed:
                child.send_signal(signal.SIGKILL)
                killed = True
        if killed:
            break
        time.sleep(0.05)
    output, errors = process.communicate(timeout=200)
    assert killed
    assert process.returncode == 0, errors
    assert "made stage=odometry segment=2011_09_26_drive_0001_sync" in output
