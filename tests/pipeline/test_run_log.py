"""The log of what each shard took: appended by several processes, read back whatever its lines hold."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from object_store import SECRET, Server, s3_server
from upvl_cli.pipeline import run_log
from upvl_cli.pipeline.run_log import RunRecord, last_runs, log_run, read_runs
from upvl_cli.pipeline.run_table import stage_runs
from upvl_cli.pipeline.storage.location import location
from upvl_cli.runtime.usage import UsageMeter

RECORD = RunRecord("flow", "s9", 40, 12.5, 24.25, 0.0, 512.0, 123456, 7890, "host", 1.0e9, "0123abcd")


def test_a_record_is_read_back_as_it_was(tmp_path: Path) -> None:
    log_run(tmp_path, RECORD)
    assert list(read_runs(tmp_path)) == [RECORD]


def test_without_a_log_there_are_no_records(tmp_path: Path) -> None:
    assert list(read_runs(tmp_path / "nowhere")) == []
    assert last_runs(tmp_path) == {}


def test_lines_of_older_versions_are_read_and_what_they_lack_is_unknown(tmp_path: Path) -> None:
    old = {"stage": "flow", "segment": "s9", "rows": 40, "seconds": 2.0}
    (tmp_path / "runs.jsonl").write_text(json.dumps(old) + "\n" + json.dumps(old | {"peak_mib": 300}) + "\n")
    first, second = read_runs(tmp_path)
    assert first == RunRecord("flow", "s9", 40, 2.0)
    assert (first.cpu_s, first.peak_mib, second.peak_mib) == (None, None, 300.0)


@pytest.mark.parametrize(
    "line",
    [
        '{"stage": "flow", "segment": "s9", "ro',
        "",
        "[]",
        "null",
        '{"stage": "flow", "segment": "s9", "rows": 1, "seconds": NaN}',
        '{"stage": "flow", "segment": "s9", "rows": 1, "seconds": 1, "size_bytes": Infinity}',
        '{"stage": "flow", "segment": "s9", "rows": "many", "seconds": 1}',
        "[" * 100_000,
        "\x00\xff",
    ],
)
def test_a_line_that_is_no_record_is_left_out(tmp_path: Path, line: str) -> None:
    (tmp_path / "runs.jsonl").write_text(line + "\n")
    log_run(tmp_path, RECORD)
    assert list(read_runs(tmp_path)) == [RECORD]


def test_a_line_without_its_end_does_not_take_the_next_one_with_it(tmp_path: Path) -> None:
    (tmp_path / "runs.jsonl").write_text('{"stage": "flow", "segm')
    log_run(tmp_path, RECORD)
    assert list(read_runs(tmp_path)) == [RECORD]


def test_the_last_run_of_a_shard_is_the_one_that_ended_last(tmp_path: Path) -> None:
    for seconds, end in ((1.0, 10.0), (2.0, 30.0), (3.0, 20.0)):
        log_run(tmp_path, replace(RECORD, seconds=seconds, end=end))
    assert last_runs(tmp_path)["flow", "s9"].seconds == 2.0


def test_parts_of_an_object_store_copied_to_a_folder_are_read_too(tmp_path: Path) -> None:
    log_run(tmp_path, RECORD)
    parts = tmp_path / "runs"
    parts.mkdir()
    (tmp_path / "runs.jsonl").rename(parts / "host-7-abcd-0.jsonl")
    log_run(tmp_path, replace(RECORD, segment="s8"))
    assert {record.segment for record in read_runs(tmp_path)} == {"s8", "s9"}


def test_processes_that_append_at_once_tear_no_line(tmp_path: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from upvl_cli.pipeline.run_log import RunRecord, log_run\n"
        "for n in range(200): log_run(Path(sys.argv[1]), RunRecord(sys.argv[2] * 300, str(n), n, 1.0))"
    )
    writers = [
        subprocess.Popen([sys.executable, "-c", program, str(tmp_path), name]) for name in ("a", "b", "c")
    ]
    assert [writer.wait(60) for writer in writers] == [0, 0, 0]
    assert len(list(read_runs(tmp_path))) == 600


def test_a_log_that_cannot_be_written_is_one_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs.jsonl").mkdir()
    log_run(tmp_path, RECORD)
    assert capsys.readouterr().err.startswith(f"upvl: warning: cannot write {tmp_path / 'runs.jsonl'}: ")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A server with one bucket."""
    with s3_server("drives") as started:
        yield started


@pytest.fixture
def remote(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the bucket that no other test uses."""
    for name, value in {**server.variables, "UPVL_CACHE": str(tmp_path / "cache")}.items():
        monkeypatch.setenv(name, value)
    return location(f"s3://drives/{tmp_path.name}")


def test_lines_for_an_object_store_are_put_as_parts(remote: Path) -> None:
    log_run(remote, RECORD)
    assert list(read_runs(remote)) == []  # collected, not put line by line
    run_log.flush_runs()
    log_run(remote, replace(RECORD, segment="s8"))
    run_log.flush_runs()
    run_log.flush_runs()  # with nothing left there is no empty part
    names = [path.name for path in (remote / "runs").iterdir()]
    assert [name.rpartition("-")[2] for name in names] == ["0.jsonl", "1.jsonl"]
    assert [record.segment for record in read_runs(remote)] == ["s9", "s8"]


def test_collected_lines_are_put_in_a_while_and_when_the_process_ends(remote: Path) -> None:
    program = (
        "import sys, time; from upvl_cli.pipeline import run_log\n"
        "from upvl_cli.pipeline.storage.location import location\n"
        "run_log.FIRST_PART_S = 0.05; out = location(sys.argv[1])\n"
        "run_log.log_run(out, run_log.RunRecord('flow', 'early', 1, 1.0)); until = time.monotonic() + 20\n"
        "while not list(run_log.read_runs(out)) and time.monotonic() < until: time.sleep(0.1)\n"
        "run_log._parts_of(out)._interval_s = 100.0; run_log.log_run(out, run_log.RunRecord('flow', 'late', 1, 1.0))"
    )
    subprocess.run([sys.executable, "-c", program, str(remote)], check=True, timeout=60)
    parts = list((remote / "runs").iterdir())
    assert [json.loads(part.read_text())["segment"] for part in parts] == ["early", "late"]


def test_a_part_that_cannot_be_put_is_one_warning(
    remote: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log_run(location("s3://nowhere-at-all/run"), RECORD)
    run_log.flush_runs()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("upvl: warning: cannot write s3://nowhere-at-all/run/runs/")
    assert SECRET not in lines[0]


@pytest.mark.parametrize(
    "damage", ["", '{"stage": "flow", "segm', "null", '{"stage": "flow", "seconds": 1}', "[" * 100_000]
)
def test_arrays_of_runs_hold_what_the_records_hold(tmp_path: Path, damage: str) -> None:
    for number in range(30):
        run = replace(RECORD, segment=f"s{number % 20}", seconds=float(number), end=float(number % 7))
        log_run(tmp_path, replace(run, cpu_s=None, peak_mib=None) if number % 3 else run)
    log_run(tmp_path, replace(RECORD, stage="pca", segment="all"))
    with (tmp_path / "runs.jsonl").open("a") as file:
        file.write(damage)
    records = {key: run for key, run in last_runs(tmp_path).items() if key[0] == "flow"}
    found = stage_runs(tmp_path)
    assert set(found) == {"flow", "pca"}
    assert (len(found["flow"].numbers), found["flow"].runs) == (20, 30)
    assert sorted(found["flow"].column("seconds")) == sorted(run.seconds for run in records.values())
    cpu_s = [run.seconds if run.cpu_s is None else run.cpu_s for run in records.values()]
    assert found["flow"].cpu_s.sum() == pytest.approx(sum(cpu_s))
    some = found["flow"].of_segments(["s3", "s11", "nowhere"])
    assert sorted(some.column("seconds")) == sorted(records["flow", name].seconds for name in ("s3", "s11"))


def test_arrays_of_runs_are_read_block_by_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_log, "_BLOCK_BYTES", 700)  # a line has some 250
    for number in range(30):
        log_run(tmp_path, replace(RECORD, segment=f"s{number}"))
    assert stage_runs(tmp_path)["flow"].runs == 30
    assert [run.segment for run in read_runs(tmp_path)] == [f"s{number}" for number in range(30)]
    assert stage_runs(tmp_path / "nowhere") == {}


def test_a_meter_counts_processor_time_of_threads_and_children() -> None:
    meter = UsageMeter()
    subprocess.run([sys.executable, "-c", "for _ in range(3_000_000): pass"], check=True)
    with_child = meter.read()
    assert with_child.cpu_s > 0.01
    assert with_child.gpu_s == 0.0
    time.sleep(0.05)
    assert meter.read().seconds >= with_child.seconds + 0.05
    assert meter.read().cpu_s < with_child.cpu_s + 0.04  # sleeping takes none
