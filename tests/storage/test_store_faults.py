"""What a store does wrong is tried again, and ends in one line where that does not help; no secret is shown."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from command import ENVIRONMENT, make_workspace, of_streets, upvl
from object_store import FAULTS, KEY, SECRET, FaultyProxy, Server, free_port, use_store, variables_of
from upvl_cli.errors import StorageError
from upvl_cli.pipeline.storage import faults, lease
from upvl_cli.pipeline.storage.location import location
from upvl_cli.runtime.atomic import atomic_file


@pytest.fixture
def proxy(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyProxy]:
    running = FaultyProxy(server.port, seed=3, share=0.3)
    use_store(monkeypatch, {**variables_of(running.port), "UPVL_STORE_TIMEOUT_S": "1.5"}, tmp_path / "cache")
    monkeypatch.setattr(faults, "_FIRST_PAUSE_S", 0.02)
    yield running
    running.close()


def test_nothing_is_lost_or_half_written_under_faults(
    proxy: FaultyProxy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lease, "SILENCE_S", 5.0)
    folder = location(f"s3://drives/{tmp_path.name}")
    chance = random.Random(5)
    content = {f"object-{number}": chance.randbytes(chance.randrange(1, 60_000)) for number in range(24)}

    def write(name: str) -> None:
        with atomic_file(folder / name, one_writer=True) as file:
            file.write(content[name])

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, [*content, *content]))  # two writers of each
    for name, expected in content.items():
        assert (folder / name).read_bytes() == expected
    assert {path.name for path in folder.iterdir()} == set(content)
    assert set(proxy.injected) == set(FAULTS)


def test_a_store_that_never_answers_gets_one_line(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_store(monkeypatch, variables_of(free_port()), tmp_path / "cache")
    monkeypatch.setattr(faults, "_FIRST_PAUSE_S", 0.01)
    with pytest.raises(StorageError) as caught:
        (location("s3://drives/run") / "a").read_bytes()
    message = str(caught.value)
    assert message.startswith("s3://drives/run/a cannot be looked at: the store does not answer")
    assert "\n" not in message and caught.value.__cause__ is None and caught.value.__suppress_context__
    assert SECRET not in message and KEY not in message


def test_a_bucket_that_is_not_there_is_named(store: str) -> None:
    with (
        pytest.raises(StorageError, match="s3://no-such-bucket/a cannot be written: there is no such bucket"),
        atomic_file(location("s3://no-such-bucket/a")) as file,
    ):
        file.write(b"x")


def test_a_full_disk_is_not_taken_for_a_store_that_fails(store: str) -> None:
    path = location(store) / "large.bin"
    with atomic_file(path) as file:
        file.write(b"x" * 100_000)
    program = (
        "import resource, sys; from upvl_cli.pipeline.storage.location import location;"
        "from upvl_cli.errors import StorageError; import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))\n"
        "try: location(sys.argv[1]).read_bytes()\n"
        "except StorageError as error: print(error)"
    )
    variables = {**os.environ, "UPVL_CACHE": os.environ["UPVL_CACHE"] + "-empty"}
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], env=variables, capture_output=True, text=True, timeout=10
    )
    assert done.stdout.startswith(f"{path} cannot be read: the local copy cannot be written"), done.stderr


def test_no_secret_is_in_what_a_run_leaves_or_says(server: Server, tmp_path: Path) -> None:
    """Neither in shards, marks and logs, nor in what a run that fails prints."""
    workspace = make_workspace(tmp_path / "work", **of_streets(1, frames=2))
    variables = {**server.variables, "UPVL_CACHE": str(tmp_path / "cache"), "UPVL_OUT": "s3://drives/secret"}
    done = upvl(workspace, "odometry", **variables)
    assert done.returncode == 0, done.stderr
    texts = [done.stdout, done.stderr]
    for broken in (
        {"UPVL_OUT": "s3://no-such-bucket/x"},
        {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{free_port()}"},
        {"UPVL_OUT": f"s3://{KEY}:{SECRET}@drives/x"},
        {"AWS_REGION": SECRET, "AWS_ENDPOINT_URL": "no address"},
        {"UPVL_CACHE_GB": "many"},
    ):
        failed = upvl(workspace, "ground", **{**variables, **broken})
        assert failed.returncode == 2, failed.stderr
        assert len(failed.stderr.strip().splitlines()) == 1, failed.stderr
        texts += [failed.stdout, failed.stderr]
    program = (
        "from upvl_cli.pipeline.storage.location import location\n"
        "location('s3://drives/x').bucket.put('k', object())"
    )
    bug = subprocess.run(
        [sys.executable, "-c", program], env={**ENVIRONMENT, **variables}, capture_output=True, text=True
    )
    assert "Traceback" in bug.stderr  # a fault of ours keeps its traceback
    texts.append(bug.stderr)
    for text in texts:
        assert SECRET not in text and KEY not in text
    for path in tmp_path.rglob("*"):
        if path.is_file():
            assert SECRET.encode() not in path.read_bytes(), path
    assert location("s3://drives/x")  # the address alone asks nothing of the store
