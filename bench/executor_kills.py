"""Label streets while workers, nodes and the driver are killed at random moments, and compare with a serial run.

    python bench/executor_kills.py [--on ray] [--drives 60] [--kills 20] [--storage local] [--seed 0]

Runs `upvl autolabel --moving-only` on the small streets of the tests, in one of four ways: `ray` (three nodes of one
core each on this machine), `slurm` (submitit's local executor), `shards` (processes with --shard, two at a time) or
`processes`. Kills with -9 as many processes as asked for, at moments drawn by the seed; a driver or a share that was
killed is started again with the same command. Then compares every shard's bytes with those of a serial run, counts how
often each shard was written (the run log of a local folder; the versions of an object on moto's S3 server), and looks
for files that were left unfinished. Ends with exit code 1 where anything differs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import psutil  # noqa: E402

from command import make_workspace  # noqa: E402

MARK = "UPVL_BENCH_KILLS"  # in the environment of every process that may be killed
BUCKET = "archive"
STORE_BYTES = 80 * 2**20
# Of twenty kills on a cluster: most hit a worker, some a node and the driver.
RAY_VICTIMS = ("worker",) * 12 + ("node",) * 4 + ("driver",) * 4
OTHER_VICTIMS = ("worker",) * 15 + ("driver",) * 5


class Run:
    """The processes of one run, and what is killed of them."""

    def __init__(
        self, given: argparse.Namespace, folder: Path, out: str, environment: Mapping[str, str]
    ) -> None:
        """Take what was asked for.

        Args:
            given: The options.
            folder: The workspace.
            out: Where the shards go.
            environment: Variables of every process.
        """
        self.given, self.folder, self.out = given, folder, out
        self.environment = {**os.environ, **environment, MARK: str(os.getpid())}
        if given.on == "slurm":
            self.environment["UPVL_THREADS"] = "2"  # of the driver: as many tasks, with one core each
        self.random = random.Random(given.seed)
        self.cluster: Any = None
        self.started = Counter[str]()

    def drivers(self) -> list[list[str]]:
        """Return the commands that label everything; those of `shards` run two at a time."""
        words = ["autolabel", "--moving-only", "--anyway"]
        if self.given.on == "shards":
            count = max(2, self.given.drives // 10)
            return [[*words, "--shard", f"{number}/{count}"] for number in range(1, count + 1)]
        places = {
            "ray": ["ray"],
            "slurm": ["slurm:local", "--slurm", "cpus=1"],
            "processes": ["processes:2"],
        }
        return [[*words, "--on", *places[self.given.on]]]

    def start(self, words: list[str]) -> subprocess.Popen[str]:
        """Start a command in the workspace."""
        self.started[" ".join(words)] += 1
        log = (self.folder / "driver.log").open("a")
        command = [sys.executable, "-m", "upvl_cli", "--out", self.out, *words]
        return subprocess.Popen(
            command, cwd=self.folder, env=self.environment, stdout=log, stderr=log, text=True
        )

    def to_end(self) -> Counter[str]:
        """Run all commands to their end, killing on the way; return how many of each kind were killed."""
        waiting, running = self.drivers(), {}
        victims = list(RAY_VICTIMS if self.given.on == "ray" else OTHER_VICTIMS)
        self.random.shuffle(victims)
        victims = [victims[number % len(victims)] for number in range(self.given.kills)]
        killed: Counter[str] = Counter()
        next_s = time.monotonic() + self.given.warm_s
        try:
            while waiting or running:
                while waiting and len(running) < 2:
                    words = waiting.pop(0)
                    running[self.start(words)] = words
                for process in [process for process in running if process.poll() is not None]:
                    words = running.pop(process)
                    if process.returncode == -9:
                        waiting.insert(0, words)
                    elif process.returncode:
                        log = (self.folder / "driver.log").read_text()[-2000:]
                        raise SystemExit(f"{words}: exit code {process.returncode}: {log}")
                if victims and time.monotonic() > next_s and running and self.kill(victims[0], list(running)):
                    killed[victims.pop(0)] += 1
                    next_s = time.monotonic() + self.random.uniform(*self.given.pause)
                time.sleep(0.1)
        finally:
            for process in running:
                process.terminate()
        return killed

    def kill(self, victim: str, drivers: list[subprocess.Popen[str]]) -> bool:
        """Kill a victim of that kind with -9; False where there is none now."""
        if victim == "driver":
            self.random.choice(drivers).kill()
            return True
        if victim == "node":
            node = self.random.choice(list(self.cluster.worker_nodes))
            self.cluster.remove_node(node, allow_graceful=False)
            self.cluster.add_node(num_cpus=1, object_store_memory=STORE_BYTES)
            return True
        workers = [process for process in self.marked() if self.is_worker(process, drivers)]
        if not workers:
            return False
        with contextlib.suppress(psutil.NoSuchProcess):
            self.random.choice(workers).kill()
            return True
        return False

    def marked(self) -> Iterator[psutil.Process]:
        """Yield the processes of this run."""
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get(MARK) == self.environment[MARK]:
                    yield process

    def is_worker(self, process: psutil.Process, drivers: list[subprocess.Popen[str]]) -> bool:
        """Return whether a process of this run makes shards for a driver."""
        with contextlib.suppress(psutil.Error):
            words = process.cmdline()
            if self.given.on == "ray":
                return (
                    bool(words) and words[0].startswith("ray::") and "street-" in words[0]
                )  # of the task's name
            if self.given.on == "shards":
                return process.pid in {driver.pid for driver in drivers}
            return process.pid not in {driver.pid for driver in drivers} and "resource_tracker" not in str(
                words
            )
        return False


@contextlib.contextmanager
def cluster_of(run: Run) -> Iterator[None]:
    """Start three nodes of one core each, where the run wants them."""
    if run.given.on != "ray":
        yield
        return
    from ray.cluster_utils import Cluster

    os.environ.update(run.environment)
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    head = {"num_cpus": 1, "include_dashboard": False, "object_store_memory": STORE_BYTES}
    run.cluster = Cluster(initialize_head=True, head_node_args=head)
    for _ in range(2):
        run.cluster.add_node(num_cpus=1, object_store_memory=STORE_BYTES)
    run.environment["RAY_ADDRESS"] = run.cluster.address
    try:
        yield
    finally:
        run.cluster.shutdown()


@contextlib.contextmanager
def storage_of(given: argparse.Namespace) -> Iterator[tuple[str, dict[str, str], Any]]:
    """Yield where the shards go, the variables of whoever writes there, and a client of the object store."""
    if given.storage == "local":
        yield "out", {}, None
        return
    import boto3

    from object_store import s3_server

    with s3_server(BUCKET) as server:
        variables = server.variables
        client = boto3.client(
            "s3", endpoint_url=variables["AWS_ENDPOINT_URL"], region_name="us-east-1",
            aws_access_key_id=variables["AWS_ACCESS_KEY_ID"],
            aws_secret_access_key=variables["AWS_SECRET_ACCESS_KEY"],
        )  # fmt: skip
        client.put_bucket_versioning(Bucket=BUCKET, VersioningConfiguration={"Status": "Enabled"})
        yield f"s3://{BUCKET}/out", variables, client


def local_shards(out: Path) -> dict[str, bytes]:
    """Return every shard of a folder, byte by byte."""
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.glob("*/*.parquet"))}


def found_shards(folder: Path, client: Any) -> tuple[dict[str, bytes], Counter[str], list[str]]:
    """Return the shards that a run left, how often each was written, and what is neither whole nor wanted."""
    if client is None:
        out = folder / "out"
        lines = (out / "runs.jsonl").read_text().splitlines()
        written = Counter(f"{line['stage']}/{line['segment']}.parquet" for line in map(json.loads, lines))
        left = [str(path) for path in out.rglob(".*.part")]
        return local_shards(out), written, left
    shards, written, left = {}, Counter[str](), []
    for page in client.get_paginator("list_objects_v2").paginate(Bucket=BUCKET, Prefix="out/"):
        for entry in page.get("Contents", ()):
            name = entry["Key"].removeprefix("out/")
            if name.endswith(".parquet"):
                shards[name] = client.get_object(Bucket=BUCKET, Key=entry["Key"])["Body"].read()
            elif "lease" in name or "lock" in name or "part" in name:
                left.append(name)
    for page in client.get_paginator("list_object_versions").paginate(Bucket=BUCKET, Prefix="out/"):
        for entry in page.get("Versions", ()):
            name = entry["Key"].removeprefix("out/")
            written[name] += name.endswith(".parquet")
    left += [str(entry) for entry in client.list_multipart_uploads(Bucket=BUCKET).get("Uploads", ())]
    return shards, +written, left


def main() -> None:
    """Run, kill, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--on", choices=["ray", "slurm", "shards", "processes"], default="ray")
    parser.add_argument("--drives", type=int, default=60)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--storage", choices=["local", "s3"], default="local")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pause", type=float, nargs=2, default=[2.0, 8.0], help="seconds between two kills")
    parser.add_argument("--warm-s", type=float, default=10.0, help="seconds before the first kill")
    parser.add_argument("--reference", type=Path, help="folder of the serial run, kept for the next call")
    given = parser.parse_args()
    for name in ("OMP_NUM_THREADS", "UPVL_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    os.environ["PYTHONPATH"] = str(ROOT / "tests")
    with tempfile.TemporaryDirectory() as temporary, storage_of(given) as (out, variables, client):
        reference = given.reference or Path(temporary) / "serial"
        folder = Path(temporary) / "killed"
        streets = {"raw__dataset": '"streets"', "raw__root": f'"{given.drives}x{given.frames}"'}
        if not (reference / "stages").is_dir():
            make_workspace(reference, **streets)
        # One that was stopped goes on; what is finished is found fresh.
        command = [sys.executable, "-m", "upvl_cli", "autolabel", "--moving-only", "--anyway"]
        subprocess.run(command, cwd=reference, check=True, stdout=subprocess.DEVNULL)
        make_workspace(folder, **streets)
        run = Run(given, folder, out, variables)
        started_s = time.monotonic()
        with cluster_of(run):
            killed = run.to_end()
        seconds = time.monotonic() - started_s
        shards, written, left = found_shards(folder, client)
        expected = local_shards(reference / "out")
    differing = sorted(
        name for name in expected.keys() | shards.keys() if expected.get(name) != shards.get(name)
    )
    twice = sorted(name for name, times in written.items() if times > 1)
    name = f"{given.on}, {given.storage}, seed {given.seed}"
    print(f"{name}, {given.drives} drives: {len(expected)} shards, {seconds:.0f} s")
    kinds = ", ".join(f"{number} {kind}" for kind, number in sorted(killed.items()))
    print(f"killed with -9: {killed.total()} ({kinds})")
    print(f"commands started: {run.started.total()}")
    print(f"shards that differ from serial: {len(differing)} {differing[:5]}")
    print(f"shards written twice: {len(twice)} {twice[:5]}")
    print(f"unfinished files left: {len(left)} {left[:5]}")
    sys.exit(bool(differing or twice or left or killed.total() < given.kills))


if __name__ == "__main__":
    main()
