"""What an executor costs beside the work, and how two processes share it.

    python bench/executors.py [overhead] [scaling] [--drives 200]

`overhead` makes a cheap stage (`boxes2d`) of many tiny drives with one worker of each kind: in this process, in one
process beside it, as Ray tasks on one core, and as one task of submitit's local executor. What starting takes is left
out: it prints the seconds that each further shard takes, from two numbers of drives, and the difference to the serial
run. `scaling` labels small streets in one and in two processes of one thread each, and prints the ratio, beside that of
a loop that only counts, which says what two cores were worth on this machine at that time.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "UPVL_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

from growth import write_drive  # noqa: E402
from upvl_cli.commands.pipeline import PIPELINE  # noqa: E402
from upvl_cli.pipeline.executors.base import Executor, Failed, Watch, Work, run_by_scope  # noqa: E402
from upvl_cli.pipeline.executors.processes import ProcessExecutor, _Pool  # noqa: E402
from upvl_cli.pipeline.executors.run import run_all  # noqa: E402
from upvl_cli.pipeline.executors.serial import SerialExecutor  # noqa: E402
from upvl_cli.pipeline.runner import Made  # noqa: E402
from upvl_cli.pipeline.workspace import Workspace  # noqa: E402
from workspaces import on_kitti  # noqa: E402

CHEAP = ("boxes2d",)
STREET = ("odometry", "ground", "flow", "pca", "extract-vl", "mask", "boxes2d", "propose", "track", "amodal")
LIMIT_MS = 20.0
COUNTS = 20_000_000


class OneProcess:
    """A process executor with a single process, which `ProcessExecutor` would not start."""

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards of `work`."""
        pool = _Pool(work, 1, watch)
        try:
            yield from run_by_scope(work, lambda jobs: pool.run(iter(jobs)))
        finally:
            pool.close()


def seconds_of(
    stages: Path, out: Path, names: tuple[str, ...], drives: list[str], executor: Executor
) -> float:
    """Return the seconds of a run into an empty folder."""
    workspace = Workspace(PIPELINE, stages, out, "moving-only")
    chosen = [PIPELINE.by_name[name] for name in names]
    started_s = time.perf_counter()
    made = list(run_all(workspace, chosen, drives, overrides={}, executor=executor))
    assert not any(shard.fresh for shard in made)
    return time.perf_counter() - started_s


def by_command(folder: Path, out: Path, drives: list[str], words: list[str]) -> float:
    """Return the seconds of `upvl boxes2d` on some drives."""
    command = [sys.executable, "-m", "upvl_cli", "--out", str(out), *CHEAP, *words]
    command += [word for drive in drives for word in ("-s", drive)]
    started_s = time.perf_counter()
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started_s


@contextmanager
def one_core_of_ray() -> Iterator[Executor]:
    """Start Ray with one core, so that one task runs at a time."""
    import ray

    from upvl_cli.pipeline.executors.ray_cluster import RayExecutor

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init(
        address="local", num_cpus=1, include_dashboard=False, object_store_memory=100 * 2**20,
        log_to_driver=False, logging_level="error",
    )  # fmt: skip
    try:
        yield RayExecutor(None)
    finally:
        ray.shutdown()


def overhead(folder: Path, drives: int) -> bool:
    """Print the seconds of a further shard by each executor; return whether all are within the limit."""
    root = folder / "drives"
    names = [write_drive(root, number, 2, 500) for number in range(1, drives + 1)]
    work = on_kitti(folder / "cheap", root, names)
    stages, few, repeats = work / "stages", names[: drives // 10], 3

    def slope_ms(measure: Callable[[Path, list[str]], float]) -> float:
        slopes = []
        for repeat in range(repeats):
            label = f"{measure.__name__}-{repeat}-{time.monotonic_ns()}"
            short = measure(folder / f"few-{label}", few)
            long = measure(folder / f"all-{label}", names)
            slopes.append(1000 * (long - short) / (len(names) - len(few)))
        return min(slopes)  # the machine can only make it slower

    def serial(out: Path, chosen: list[str]) -> float:
        return seconds_of(stages, out, CHEAP, chosen, SerialExecutor())

    def process(out: Path, chosen: list[str]) -> float:
        return seconds_of(stages, out, CHEAP, chosen, OneProcess())

    def command(out: Path, chosen: list[str]) -> float:
        return by_command(work, out, chosen, [])

    def slurm(out: Path, chosen: list[str]) -> float:
        return by_command(work, out, chosen, ["--on", "slurm:local", "--slurm", "tasks=1"])

    seconds_of(stages, folder / "warm", CHEAP, few, SerialExecutor())
    found = {"serial": slope_ms(serial), "processes": slope_ms(process)}
    with one_core_of_ray() as executor:
        found["ray"] = slope_ms(lambda out, chosen: seconds_of(stages, out, CHEAP, chosen, executor))
    found |= {"serial command": slope_ms(command), "slurm": slope_ms(slurm)}
    is_within = True
    for name, ms in found.items():
        base = found["serial command" if name == "slurm" else "serial"]
        is_within &= ms - base <= LIMIT_MS
        print(
            f"overhead: {name}: {ms:.1f} ms a shard, {ms - base:+.1f} ms beside the work (limit {LIMIT_MS:.0f})"
        )
    return is_within


def _count() -> None:
    number = 0
    while number < COUNTS:
        number += 1


def loop_ratio() -> float:
    """Return how much two processes that only count get done in the time of one."""

    def seconds(processes: int) -> float:
        running = [multiprocessing.Process(target=_count) for _ in range(processes)]
        started_s = time.perf_counter()
        for process in running:
            process.start()
        for process in running:
            process.join()
        return time.perf_counter() - started_s

    return 2 * seconds(1) / seconds(2)


def scaling(folder: Path, drives: int) -> bool:
    """Print how much faster two processes are than one; return whether that is 1.8 times, or what the cores gave."""
    root = folder / "streets"
    names = [write_drive(root, number, 20, 4000) for number in range(1, drives + 1)]
    stages = on_kitti(folder / "streets-work", root, names) / "stages"
    before = loop_ratio()
    one = seconds_of(stages, folder / "one", STREET, names, OneProcess())
    two = seconds_of(stages, folder / "two", STREET, names, ProcessExecutor(2))
    loops = (before + loop_ratio()) / 2
    print(f"scaling: {one:.1f} s in one process, {two:.1f} s in two: {one / two:.2f} times")
    print(f"scaling: two counting loops: {loops:.2f} times; of that {100 * one / two / loops:.0f} %")
    return one / two >= 1.8


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", default=["overhead", "scaling"])
    parser.add_argument("--drives", type=int, default=200, help="tiny drives of the measure of overhead")
    parser.add_argument("--streets", type=int, default=16, help="drives of the measure of scaling")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        passed = [
            overhead(Path(temporary), given.drives)
            if part == "overhead"
            else scaling(Path(temporary), given.streets)
            for part in given.parts
        ]
    sys.exit(not all(passed))


if __name__ == "__main__":
    main()
