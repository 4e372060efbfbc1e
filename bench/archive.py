"""Freshness and planning at scale: seconds and peak memory of commands over many shards.

    python bench/archive.py local [--drives 5900]        shards with real footers on this disk, drives in KITTI's layout
    python bench/archive.py s3 [--drives 5900]           the same in a simulated object store; --moto: in moto's
    python bench/archive.py simulated [--drives 1000000] an archive that exists as listings and a catalogue alone

Each command is a process of its own, whose peak (MiB) is that of its resident memory. What is written goes into a
temporary folder (--folder names its place) and is deleted at the end.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import archive_catalog
import archive_shards
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.workspace import Workspace


@dataclass(frozen=True)
class Measured:
    """What a command took, and what it printed."""

    seconds: float
    cpu_s: float
    peak_mib: float
    output: str


def measure(folder: Path, *arguments: str, environment: dict[str, str] | None = None) -> Measured:
    """Run `upvl` in a folder and wait for its end."""
    command = [sys.executable, "-m", "upvl_cli", *arguments]
    started = time.perf_counter()
    with (folder / "output.txt").open("w+") as output:
        child = subprocess.Popen(
            command, cwd=folder, stdout=output, stderr=output,
            env={**os.environ, "COLUMNS": "140", "NO_COLOR": "1", **(environment or {})},
        )  # fmt: skip
        _, code, usage = os.wait4(child.pid, 0)
        seconds = time.perf_counter() - started
        output.seek(0)
        text = output.read()
    if code:
        raise SystemExit(f"upvl {' '.join(arguments)} failed:\n{text[-2000:]}")
    return Measured(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, text)


def show(what: str, measured: Measured, more: str = "") -> None:
    """Print one line of the table."""
    print(
        f"{what:58s} {measured.seconds:7.1f} s {measured.cpu_s:7.1f} s CPU {measured.peak_mib:7.0f} MiB  {more}",
        flush=True,
    )


def local(folder: Path, drives: int) -> None:
    """Measure status and tasks on shards of this disk."""
    workspace = made(folder, drives)
    out = workspace.out

    def put(place: str, content: bytes) -> None:
        path = out / place
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)

    names = list(archive_shards.shards(workspace, put, folder))
    size = sum(
        entry.stat().st_size for stage in out.iterdir() if stage.is_dir() for entry in os.scandir(stage)
    )
    print(f"{len(names)} shards, {size / 1e9:.2f} GB", flush=True)
    for stage, segment in names[:: len(names) // 20]:
        assert state(workspace, workspace.pipeline.by_name[stage], segment)[0] == "fresh", (stage, segment)
    archive_shards.write_raw(folder, "kitti", folder / "drives", immutable=True)
    show("status, no catalogue yet: every footer read", measure(folder, "status"))
    measured = measure(folder, "status")
    print(measured.output)
    catalog = sum(path.stat().st_size for path in (out / "catalog").rglob("*.parquet"))
    show("status, drives that never change", measured, f"catalogue {catalog / 1e6:.1f} MB")
    show("plan --next 1000", measure(folder, "plan", "--next", "1000"))
    for segment in workspace.segments[:1000]:
        (out / "labels" / f"{segment}.parquet").unlink()
    measured = measure(folder, "plan", "--next", "1000")
    show("plan --next 1000, 1000 shards deleted", measured, f"{len(measured.output.splitlines())} tasks")
    archive_shards.write_raw(folder, "kitti", folder / "drives", immutable=False)
    show("status, every drive opened and its files looked at", measure(folder, "status"))


def made(folder: Path, drives: int) -> Workspace:
    """Make the drives and the settings."""
    started = time.perf_counter()
    files = archive_shards.make_drives(folder / "drives", drives, frames=4)
    workspace = archive_shards.make_settings(folder, folder / "drives")
    for segment in workspace.segments:
        workspace.mark_raw(segment)
    print(f"{drives} drives of {files} files in {time.perf_counter() - started:.0f} s", flush=True)
    return workspace


@contextlib.contextmanager
def server(*arguments: str) -> Iterator[dict[str, str]]:
    """Start the simulated object store; give the environment of those who use it."""
    command = [sys.executable, str(Path(__file__).with_name("archive_server.py")), *arguments]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout
        yield environment_of(f"http://127.0.0.1:{int(child.stdout.readline())}")
    finally:
        child.kill()
        child.wait()


@contextlib.contextmanager
def moto() -> Iterator[dict[str, str]]:
    """Start moto's server; give the environment of those who use it."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    child = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        url = f"http://127.0.0.1:{port}"
        for _ in range(600):
            with contextlib.suppress(OSError), urllib.request.urlopen(f"{url}/moto-api/"):
                break
            time.sleep(0.1)
        urllib.request.urlopen(urllib.request.Request(f"{url}/bucket", method="PUT")).read()
        yield environment_of(url)
    finally:
        child.kill()
        child.wait()


def environment_of(url: str) -> dict[str, str]:
    """Return the environment of processes that use a server."""
    return {
        "AWS_ENDPOINT_URL": url, "AWS_ACCESS_KEY_ID": "bench", "AWS_SECRET_ACCESS_KEY": "bench",
        "AWS_REGION": "us-east-1",
    }  # fmt: skip


def requests_of(environment: dict[str, str]) -> str:
    """Return how many requests the simulated server has answered since the last time; nothing for moto's."""
    with (
        contextlib.suppress(OSError),
        urllib.request.urlopen(f"{environment['AWS_ENDPOINT_URL']}/-/requests") as got,
    ):
        return str(got.read().decode())
    return ""


def s3(folder: Path, drives: int, *, in_moto: bool) -> None:
    """Measure status and tasks on shards of an object store; the drives are on this disk and never change."""
    with moto() if in_moto else server() as environment:
        os.environ |= environment
        local_workspace = made(folder, drives)
        archive_shards.write_raw(folder, "kitti", folder / "drives", immutable=True)
        out = ("--out", "s3://bucket/out")
        from upvl_cli.pipeline.storage.remote_path import RemotePath

        bucket = RemotePath("s3:", "bucket").bucket
        started = time.perf_counter()
        with ThreadPoolExecutor(8) as pool:
            waiting: deque[Future[str]] = deque()

            def put(place: str, content: bytes) -> None:
                waiting.append(pool.submit(bucket.put, f"out/{place}", content))
                while len(waiting) > 64:
                    waiting.popleft().result()

            names = list(archive_shards.shards(local_workspace, put, folder))
        for put_one in waiting:
            put_one.result()
        print(f"{len(names)} shards put in {time.perf_counter() - started:.0f} s", flush=True)
        requests_of(environment)
        for what, arguments in (
            ("status, no catalogue yet: every footer read", ("status",)),
            ("status", ("status",)),
            ("plan --next 1000", ("plan", "--next", "1000")),
        ):
            measured = measure(folder, *out, *arguments)
            show(what, measured, requests_of(environment))
        print(measure(folder, *out, "status").output)


def simulated(folder: Path, drives: int) -> None:
    """Measure status and tasks of an archive of which only listings and the catalogue exist."""
    workspace = archive_catalog.make_workspace(folder, drives)
    files = folder / "served"
    stages = archive_catalog.write_catalog(workspace, files, drives)
    size = sum(path.stat().st_size for path in files.rglob("*.parquet"))
    print(f"{drives} drives, {len(stages)} stages, catalogue of {size / 1e6:.0f} MB", flush=True)
    arguments = ("--segments", str(drives), "--stages", ",".join(stages), "--files", str(files))
    with server(*arguments) as environment:
        environment |= {"PYTHONPATH": os.pathsep.join([str(folder), str(Path(__file__).parent)])}
        environment |= {"UPVL_CACHE": str(folder / "cache")}
        for command in (
            ("status", "--from-catalog"),
            ("plan", "--next", "1000", "--from-catalog"),
            ("status",),
            ("plan", "--next", "1000"),
        ):
            measured = measure(folder, "--out", "s3://bucket/out", *command, environment=environment)
            print(*measured.output.splitlines()[:22], sep="\n")
            show(" ".join(command), measured, requests_of(environment))


def main() -> None:
    """Run what the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("local", "s3", "simulated"))
    parser.add_argument("--drives", type=int)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--moto", action="store_true")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="archive-", dir=options.folder))
    try:
        if options.what == "local":
            local(folder, options.drives or 5900)
        elif options.what == "s3":
            s3(folder, options.drives or 5900, in_moto=options.moto)
        else:
            simulated(folder, options.drives or 1_000_000)
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
