"""One writer at a time: what becomes of the lease of a process that was killed or falls silent."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from toy_pipeline import STAGES, numbers_workspace
from upvl_cli.pipeline.executors.run import run_all
from upvl_cli.pipeline.run_log import flush_runs
from upvl_cli.pipeline.storage import lease
from upvl_cli.pipeline.storage.lease import Lease
from upvl_cli.pipeline.storage.location import location
from upvl_cli.pipeline.storage.remote_path import RemotePath

HOLDER = """
import sys, time
from upvl_cli.pipeline.storage.location import location
from upvl_cli.runtime.atomic import atomic_file
with atomic_file(location(sys.argv[1]), one_writer=True) as file:
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def target(store: str) -> RemotePath:
    path = location(store) / ".shard.lease"
    assert isinstance(path, RemotePath)
    return path


def wait_for(path: RemotePath) -> float:
    started = time.monotonic()
    with Lease(path.bucket, path.key):
        return time.monotonic() - started


def test_the_lease_of_a_killed_process_of_this_machine_is_taken_at_once(store: str) -> None:
    path = location(store) / "shard.parquet"
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE) as holder:
        assert holder.stdout and holder.stdout.readline() == b"held\n"
        holder.send_signal(signal.SIGKILL)
    held = path.with_name(".shard.parquet.lease")
    assert isinstance(held, RemotePath) and held.is_file()
    assert wait_for(held) < 5
    assert not held.is_file() and not path.exists()


def test_the_lease_of_a_silent_process_elsewhere_ends(
    target: RemotePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lease, "SILENCE_S", 1.0)
    other = {"owner": "other", "host": "elsewhere", "boot": "another", "pid": 1, "started": "1"}
    target.bucket.put_if(target.key, json.dumps(other).encode(), None)
    assert 1.0 < wait_for(target) < 10


def test_a_lease_that_is_renewed_is_not_taken(target: RemotePath, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease, "SILENCE_S", 1.0)
    monkeypatch.setattr(lease, "_is_dead", lambda holder: False)
    with Lease(target.bucket, target.key):
        first = target.version
        time.sleep(3)
        assert target.version != first
        assert json.loads(target.read_bytes())["renewals"] >= 2


def test_a_lease_that_was_lost_is_not_deleted(target: RemotePath, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease, "SILENCE_S", 0.6)
    with Lease(target.bucket, target.key):
        target.bucket.put(target.key, b'{"owner": "another"}')
        time.sleep(1)
    assert target.read_bytes() == b'{"owner": "another"}'


@pytest.mark.parametrize("text", [b"", b"[]", b"\xff", b'{"pid": "x"}', b'{"pid": 1e9, "boot": null}'])
def test_a_damaged_lease_ends_too(target: RemotePath, monkeypatch: pytest.MonkeyPatch, text: bytes) -> None:
    monkeypatch.setattr(lease, "SILENCE_S", 0.5)
    target.bucket.put(target.key, text)
    assert wait_for(target) < 10


def test_the_lease_of_a_shard_that_was_finished_is_removed(store: str, tmp_path: Path) -> None:
    """Its maker was killed between the shard and the end of its lease."""
    workspace = numbers_workspace(tmp_path / "w", 2, out=location(store))
    list(run_all(workspace, STAGES, workspace.segments, overrides={}))
    left = workspace.shard("share", "drive-001").with_name(".drive-001.parquet.lease")
    assert isinstance(left, RemotePath)
    left.bucket.put_if(left.key, b"{}", None)
    again = run_all(workspace, STAGES, workspace.segments, overrides={})
    assert all(shard.fresh for shard in again)
    assert not left.is_file()
    flush_runs()  # while the store is there
