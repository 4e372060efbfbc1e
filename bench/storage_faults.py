"""Labels a street with its results in an object store whose requests are spoilt, and compares the bytes.

    python bench/storage_faults.py [--faults 200] [--share 0.2]

Runs an S3-compatible server, a proxy before it that spoils a share of all requests (answers of 500 and 503, no answer,
a connection cut in the middle of a request or of an answer, a lost answer, a slow answer), and labels the built-in
test street with `out` in the store, as often as it takes to inject that many faults, two processes at once each time.
Prints how many requests were made and spoilt, and whether every shard has the bytes of a run on the local disk.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from command import ENVIRONMENT, UPVL, make_workspace, upvl  # noqa: E402
from object_store import FaultyProxy, s3_server, variables_of  # noqa: E402

BUCKET = "runs"


def main() -> int:
    """Print the figures; 1 where something was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=200, help="number of faults")
    parser.add_argument("--share", type=float, default=0.2, help="share of the requests that are spoilt")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, s3_server(BUCKET) as server:
        folder = make_workspace(Path(name) / "work")
        started = time.perf_counter()
        done = upvl(folder, "autolabel", "--moving-only")
        assert done.returncode == 0, done.stderr
        print(f"on the local disk: {time.perf_counter() - started:.1f} s")
        plain = FaultyProxy(server.port, seed=0, share=0)
        _label(folder, plain, "plain", processes=1)
        print(f"in a store without faults: {plain.requests.total()} requests")
        plain.close()
        injected: Counter[str] = Counter()
        requests, messages, number, differing = 0, [], 0, 0
        while injected.total() < chosen.faults:
            proxy = FaultyProxy(server.port, seed=number, share=chosen.share)
            messages += _label(folder, proxy, f"run-{number}", processes=2)
            injected += proxy.injected
            requests += proxy.requests.total()
            proxy.close()
            differing += _differing(folder, server.port, f"run-{number}")
            number += 1
        print(
            f"{number} runs of two processes: {requests} requests, {injected.total()} spoilt ({dict(injected)}); "
            f"{differing} shards differ from those of the local disk, or are missing; {len(messages)} commands ended "
            "with a message, and were run again"
        )
        for message in messages:
            print(f"  {message}")
        return int(differing > 0 or any("\n" in message for message in messages))


def _label(folder: Path, proxy: FaultyProxy, run: str, processes: int) -> list[str]:
    """Label with so many processes at once; return what those said that gave up, which are run again."""
    messages = []
    cache = folder / f"cache-{run}"
    environment = {
        **ENVIRONMENT,
        **variables_of(proxy.port),
        "UPVL_OUT": f"s3://{BUCKET}/{run}",
        "UPVL_STORE_TIMEOUT_S": "2",
    }
    left = processes
    while left:
        running = [
            subprocess.Popen(
                [UPVL, "autolabel", "--moving-only"],
                cwd=folder,
                env={**environment, "UPVL_CACHE": f"{cache}-{number}"},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            for number in range(left)
        ]
        left = 0
        for process in running:
            _, error = process.communicate()
            if process.returncode:
                messages.append(error.strip())
                left += 1
    return messages


def _differing(folder: Path, port: int, run: str) -> int:
    """Return how many shards in the store differ from those of the local disk, or are missing or too many."""
    from obstore import get, list
    from obstore.store import S3Store

    os.environ.update(variables_of(port))
    store = S3Store(BUCKET, client_options={"allow_http": True}, endpoint=f"http://127.0.0.1:{port}")
    found = {
        item["path"].removeprefix(f"{run}/"): bytes(get(store, item["path"]).bytes())
        for batch in list(store, f"{run}/")
        for item in batch
    }
    shards = {
        str(path.relative_to(folder / "out")): path.read_bytes() for path in folder.glob("out/*/*.parquet")
    }
    stored = {name: content for name, content in found.items() if name.endswith(".parquet")}
    leases = [name for name in found if name.endswith((".lease", ".part"))]
    return sum(stored.get(name) != content for name, content in shards.items()) + len(leases)


if __name__ == "__main__":
    sys.exit(main())
