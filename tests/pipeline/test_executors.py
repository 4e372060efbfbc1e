"""Where shards are made changes nothing in them, and a worker that dies costs one drive's unfinished shard."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from toy_pipeline import STAGES, check_number, numbered_shards, numbers_workspace
from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.executors.base import (
    ATTEMPTS,
    Executor,
    Failed,
    FirstCheck,
    Started,
    Unwatched,
    Warned,
    Watch,
)
from upvl_cli.pipeline.executors.choose import choose
from upvl_cli.pipeline.executors.processes import ProcessExecutor
from upvl_cli.pipeline.executors.run import run_all
from upvl_cli.pipeline.executors.serial import SerialExecutor
from upvl_cli.pipeline.executors.share import Share
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.workspace import Workspace


def run(
    workspace: Workspace, executor: Executor, watch: Watch | None = None, check: FirstCheck | None = None
) -> list[Made]:
    return list(
        run_all(
            workspace, STAGES, workspace.segments, overrides={}, executor=executor, watch=watch, check=check
        )
    )


def logged(workspace: Workspace) -> Counter[tuple[str, str]]:
    """How often each shard was made."""
    lines = (workspace.out / "runs.jsonl").read_text().splitlines()
    return Counter((line["stage"], line["segment"]) for line in map(json.loads, lines))


@pytest.fixture
def expected(tmp_path: Path) -> dict[str, bytes]:
    """The shards of six drives, made in this process."""
    workspace = numbers_workspace(tmp_path / "serial", 6)
    assert len(run(workspace, SerialExecutor())) == 3 * 6 + 1
    return numbered_shards(workspace)


class Listener(Unwatched):
    def __init__(self) -> None:
        self.begun_shards: list[Started] = []
        self.texts: list[str] = []
        self.failed_at: list[tuple[str, str]] = []

    @property
    def where(self) -> set[str]:
        return {started.where for started in self.begun_shards}

    def started(self, started: Started) -> None:
        self.begun_shards.append(started)

    def warned(self, warned: Warned) -> None:
        self.texts.append(warned.text)

    def failed(self, failed: Failed) -> None:
        self.failed_at.append((failed.stage, failed.segment))


def test_processes_make_the_same_bytes_and_report_each_shard(
    tmp_path: Path, expected: dict[str, bytes]
) -> None:
    workspace, listener = numbers_workspace(tmp_path / "w", 6), Listener()
    made = run(workspace, ProcessExecutor(2), listener)
    assert numbered_shards(workspace) == expected
    assert Counter(shard.stage for shard in made) == {"times": 6, "count": 1, "share": 6, "square": 6}
    assert listener.where == {"process 1", "process 2", "here"}  # the stage of the whole dataset is made here
    assert all(shard.fresh for shard in run(workspace, ProcessExecutor(2)))


def test_no_job_is_made_of_a_drive_that_is_fresh(tmp_path: Path) -> None:
    class Segments(Unwatched):
        def __init__(self) -> None:
            self.begun: list[str] = []

        def started(self, started: Started) -> None:
            self.begun.append(started.segment)

    workspace, first, again = numbers_workspace(tmp_path / "w", 40), Segments(), Segments()
    made = run(workspace, SerialExecutor(), first)
    assert len(first.begun) == len(made) == 3 * 40 + 1
    workspace.shard("square", "drive-007").unlink()
    found = run(workspace, SerialExecutor(), again)
    assert set(again.begun) == {"all", "drive-007"}
    assert len(found) == len(made) and [shard.segment for shard in found if not shard.fresh] == ["drive-007"]


def test_a_killed_process_is_replaced_and_nothing_finished_is_made_again(
    tmp_path: Path, expected: dict[str, bytes]
) -> None:
    workspace = numbers_workspace(tmp_path / "w", 6)
    for drive in ("drive-001", "drive-004"):
        (tmp_path / "w" / "raw" / f"kill-{drive}").write_text("2")
    run(workspace, ProcessExecutor(2))
    assert numbered_shards(workspace) == expected
    assert set(logged(workspace).values()) == {1}


def test_a_drive_that_kills_every_process_fails_and_the_others_go_on(tmp_path: Path) -> None:
    workspace = numbers_workspace(tmp_path / "w", 6)
    (tmp_path / "w" / "raw" / "kill-drive-001").write_text("100")
    with pytest.raises(
        UpvlError, match=f"times: its process was killed {ATTEMPTS} times in drive-001; run it"
    ):
        run(workspace, ProcessExecutor(2))
    assert (tmp_path / "w" / "raw" / "kill-drive-001").read_text() == str(100 - ATTEMPTS)
    assert [path.stem for path in sorted((workspace.out / "square").glob("*.parquet"))] == [
        f"drive-00{number}" for number in (0, 2, 3, 4, 5)
    ]


@pytest.mark.parametrize("executor", [SerialExecutor(), ProcessExecutor(2)], ids=["serial", "processes"])
def test_each_drive_is_checked_once_before_it_is_begun(tmp_path: Path, executor: Executor) -> None:
    workspace, watch = numbers_workspace(tmp_path / "w", 6), Listener()
    for name in ("odd-drive-001", "odd-drive-002", "faulty-drive-002"):
        (tmp_path / "w" / "raw" / name).touch()
    with pytest.raises(UpvlError, match=r"1 of 6 drives failed.*drive-002: drive-002 is faulty"):
        run(workspace, executor, watch, check_number)
    assert sorted(watch.texts) == ["warning: drive-001 is odd", "warning: drive-002 is odd"]
    assert watch.failed_at == [("check", "drive-002")]
    assert {segment for _, segment in logged(workspace)} == {f"drive-00{n}" for n in (0, 1, 3, 4, 5)} | {
        "all"
    }
    checked = [path.read_text() for path in sorted((tmp_path / "w" / "raw").glob("checked-*"))]
    assert checked == ["1"] * 6


def test_where_every_drive_is_faulty_nothing_is_made(tmp_path: Path) -> None:
    workspace = numbers_workspace(tmp_path / "w", 12)
    for drive in workspace.segments:
        (tmp_path / "w" / "raw" / f"faulty-{drive}").touch()
    with pytest.raises(UpvlError) as caught:
        run(workspace, SerialExecutor(), check=check_number)
    message = str(caught.value)
    assert message.startswith("12 of 12 drives failed. drive-000: drive-000 is faulty; drive-001: ")
    assert message.endswith(
        "drive-009 is faulty; and 2 more, named by the same command once these are mended"
    )
    assert not list(workspace.out.glob("*/*.parquet"))


@pytest.mark.parametrize("executor", [SerialExecutor(), ProcessExecutor(2)], ids=["serial", "processes"])
def test_a_drive_that_cannot_be_read_is_told_and_the_others_are_done(
    tmp_path: Path, executor: Executor
) -> None:
    workspace = numbers_workspace(tmp_path / "w", 4)
    (tmp_path / "w" / "raw" / "fail-drive-002").write_text("100")
    with pytest.raises(
        UpvlError, match="1 of 4 drives failed, the others are done. drive-002: drive-002 cannot"
    ):
        run(workspace, executor)
    assert len(list((workspace.out / "square").glob("*.parquet"))) == 3


def test_a_bug_in_a_process_ends_the_run_with_its_traceback(tmp_path: Path) -> None:
    workspace = numbers_workspace(tmp_path / "w", 4)
    (tmp_path / "w" / "raw" / "bug-drive-002").write_text("1")
    with pytest.raises(ZeroDivisionError, match="a bug") as caught:
        run(workspace, ProcessExecutor(2))
    assert "toy_pipeline.py" in caught.value.__notes__[0]


def test_shares_are_disjoint_and_cover_all_drives() -> None:
    drives = ["c", "a", "e", "b", "d"]  # as raw.toml may name them
    assert [Share.parse(f"{number}/2").of(drives) for number in (1, 2)] == [["a", "c", "e"], ["b", "d"]]
    assert [Share(number, 9).of(drives) for number in range(1, 10)] == [
        ["a"], ["b"], ["c"], ["d"], ["e"], [], [], [], []
    ]  # fmt: skip
    assert Share.parse("3/64").of([f"{number:03d}" for number in range(1, 201)]) == [
        "003",
        "067",
        "131",
        "195",
    ]


@pytest.mark.parametrize("text", ["0/64", "65/64", "x", "", "1/0", "3", "-1/4", "1/4/2", "1 / 4", "٣/٤"])
def test_what_is_no_share_is_one_clear_line(text: str) -> None:
    with pytest.raises(BadSetting, match="expected I/N with I from 1 to N.*JOB_COMPLETION_INDEX \\+ 1"):
        Share.parse(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("process:8", "did you mean processes"),
        ("sirial", "did you mean serial"),
        ("kubernetes", "expected serial, processes:8, ray, ray://head:10001 or slurm$"),
        ("serial:2", "expected serial"),
        ("processes:0", "a number of processes from 1 to 9999"),
        ("processes:", "a number of processes from 1 to 9999"),
        ("processes:two", "a number of processes from 1 to 9999"),
        ("", "expected serial"),
    ],
)
def test_what_is_no_executor_is_one_clear_line(text: str, message: str) -> None:
    with pytest.raises(BadSetting, match=message):
        choose(text)


def test_detect_is_asked_whose_objects_and_where_by_one_option() -> None:
    from upvl_cli.cli.stages import _objects_and_place
    from upvl_cli.stages import detect, pool_features

    assert _objects_and_place(["labels"], detect.STAGE, {}) == (pool_features.STAGE, None)
    assert _objects_and_place(["ray", "labels"], detect.STAGE, {}) == (pool_features.STAGE, "ray")
    assert _objects_and_place(["processes:2"], detect.STAGE, {"x": 1}) == (detect.STAGE, "processes:2")
    with pytest.raises(
        BadSetting, match="--on 'boxes': expected detector or labels, or where to work: serial"
    ):
        _objects_and_place(["boxes"], detect.STAGE, {})
    with pytest.raises(BadSetting, match="--on ray --on slurm: expected whose objects once, and where"):
        _objects_and_place(["ray", "slurm"], detect.STAGE, {})
