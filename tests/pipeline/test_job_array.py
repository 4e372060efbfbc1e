"""A job array whose tasks are killed, run by submitit on this machine: what each end costs, and whom."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import pytest
from test_executors import Listener, logged, run

from toy_pipeline import check_number, numbered_shards, numbers_workspace
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.executors.base import ATTEMPTS, Failed, Started, Warned
from upvl_cli.pipeline.executors.job_array import QueueCommand
from upvl_cli.pipeline.executors.reports import ReportingExecutor, ReportReader
from upvl_cli.pipeline.executors.serial import SerialExecutor
from upvl_cli.pipeline.executors.share import Share
from upvl_cli.pipeline.executors.slurm_options import SlurmOptions
from upvl_cli.pipeline.executors.slurm_queue import SlurmExecutor
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.workspace import Workspace

DRIVES = 6
TESTS = Path(__file__).parents[1]


def array_of(workspace: Workspace, tasks: int = 2) -> SlurmExecutor:
    """An array on this machine that makes the shards of a workspace."""
    program = (sys.executable, "-m", "numbers_command", str(workspace.out.parent))
    return SlurmExecutor(QueueCommand(program, (), SlurmOptions(tasks=tasks), is_local=True))


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    """Six drives, of which files beside them say what happens to those who read them."""
    pytest.importorskip("submitit")
    monkeypatch.setenv("PYTHONPATH", str(TESTS))
    return numbers_workspace(tmp_path / "w", DRIVES)


def expect(workspace: Workspace, what: str, drive: int, times: int) -> None:
    (workspace.out.parent / "raw" / f"{what}-drive-{drive:03d}").write_text(str(times))


def test_a_share_without_one_drive_is_shares_of_all_the_others() -> None:
    names = [f"drive-{number}" for number in range(100, 123)]
    for share in (Share(1, 1), Share(2, 3), Share(3, 3)):
        own = share.of(names)
        for name in own:
            parts = [part.of(names) for part in share.without(name, names)]
            assert sorted(sum(parts, [])) == [other for other in own if other != name]
            assert all(parts)
            assert len(parts) <= len(own).bit_length()
    assert Share(5, 30).without("drive-104", names) == []


def test_a_task_reports_what_it_is_at(workspace: Workspace, tmp_path: Path) -> None:
    expect(workspace, "fail", 2, 1)
    expect(workspace, "odd", 1, 1)
    path, listener = tmp_path / "reports.jsonl", Listener()
    reader = ReportReader(path, "job 7")
    assert not list(reader.new())  # the task has not begun
    with pytest.raises(UpvlError, match="drive-002 cannot be read"):
        run(workspace, ReportingExecutor(SerialExecutor(), path), listener, check_number)
    events = list(reader.new())
    assert [event for event in events if isinstance(event, Started)] == [
        Started(started.stage, started.segment, "job 7") for started in listener.begun_shards
    ]
    made = [event for event in events if isinstance(event, Made)]
    assert Counter(shard.stage for shard in made) == {"times": 5, "count": 1, "share": 5, "square": 5}
    assert not any(shard.fresh for shard in made)
    assert [event for event in events if isinstance(event, Warned)] == [
        Warned("drive-001", "warning: drive-001 is odd")
    ]
    (failed,) = (event for event in events if isinstance(event, Failed))
    assert (failed.stage, failed.segment) == ("times", "drive-002")
    assert isinstance(failed.error, UpvlError)
    assert str(failed.error) == "drive-002 cannot be read; delete it"
    assert sum(event for event in events if isinstance(event, int)) == len(made)  # one frame each
    assert reader.at is None


def test_the_end_of_a_line_that_is_being_written_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "reports.jsonl"
    reader = ReportReader(path, "job 7")
    path.write_text('{"event": "started", "stage": "flow", "segment": "a"}\n{"event": "sta')
    assert list(reader.new()) == [Started("flow", "a", "job 7")]
    assert reader.at == ("flow", "a")
    with path.open("a") as file:
        file.write('rted", "stage": "mask", "segment": "b"}\n\0\0\n{"frames": 3}\n')
    assert list(reader.new()) == [Started("mask", "b", "job 7"), 3]  # what cannot be read is left out
    assert reader.at == ("mask", "b")


def test_a_task_that_goes_on_between_its_ends_is_not_given_up(workspace: Workspace, tmp_path: Path) -> None:
    """One task carries six drives; it is ended five times, four of them before its first shard."""
    serial = numbers_workspace(tmp_path / "serial", DRIVES)
    run(serial, SerialExecutor())
    (workspace.out.parent / "raw" / "starts").write_text("11011")
    expect(workspace, "kill", 2, 1)
    made = run(workspace, array_of(workspace, tasks=1))
    assert len(made) == 3 * DRIVES + 1
    assert numbered_shards(workspace) == numbered_shards(serial)
    assert set(logged(workspace).values()) == {1}


@pytest.mark.slow
def test_a_share_whose_tasks_never_begin_is_given_up(workspace: Workspace) -> None:
    (workspace.out.parent / "raw" / "starts").write_text("1" * 100)
    message = f"6 of 6 drives failed.*drive-000: its task was ended {ATTEMPTS} times before a shard was made; the logs"
    with pytest.raises(UpvlError, match=message):
        run(workspace, array_of(workspace, tasks=1))
    assert (workspace.out.parent / "raw" / "starts").read_text() == "1" * (100 - ATTEMPTS)


@pytest.mark.slow
def test_shards_that_are_found_fresh_are_no_progress(workspace: Workspace) -> None:
    """Each task is killed after its last shard: the first made them all, and those after it find them."""
    (workspace.out.parent / "raw" / "starts").write_text("2" * 100)
    assert len(run(workspace, array_of(workspace, tasks=1))) == 3 * DRIVES + 1
    assert (workspace.out.parent / "raw" / "starts").read_text() == "2" * (100 - ATTEMPTS)


def test_a_bug_is_named_with_the_place_of_its_traceback(workspace: Workspace) -> None:
    expect(workspace, "bug", 0, 1)
    with pytest.raises(
        UpvlError, match="ended with ZeroDivisionError: a bug; its traceback is in "
    ) as caught:
        run(workspace, array_of(workspace, tasks=1))
    folder = Path(str(caught.value).partition("its traceback is in ")[2].partition(";")[0])
    assert any("in number\n" in log.read_text() for log in folder.glob("*.err"))


def test_a_drive_that_ends_every_task_fails_and_the_others_go_on(workspace: Workspace) -> None:
    expect(workspace, "kill", 1, 100)
    expect(workspace, "fail", 2, 1)
    message = (
        f"2 of {DRIVES} drives failed.*drive-001: times: its task was ended {ATTEMPTS} times in drive-001; ask for "
        "more with --slurm memory=GIB,time=MINUTES.*; drive-002: drive-002 cannot be read; delete it"
    )
    with pytest.raises(UpvlError, match=message):
        run(workspace, array_of(workspace))
    assert (workspace.out.parent / "raw" / "kill-drive-001").read_text() == str(100 - ATTEMPTS)
    assert len(list((workspace.out / "square").glob("*.parquet"))) == DRIVES - 2
    assert set(logged(workspace).values()) == {1}
