"""Make shards on a Ray cluster: a task for consecutive stages of a drive that need the same kind of machine."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from types import ModuleType
from typing import Any

from upvl_cli.errors import BadSetting, UpvlError, one_line
from upvl_cli.pipeline.executors.base import (
    ATTEMPTS,
    Failed,
    Job,
    Started,
    Warned,
    Watch,
    Work,
    lost_job,
    run_by_scope,
)
from upvl_cli.pipeline.executors.ray_task import Arrived, Parcel, run_task, run_task_at_once
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.stage import Needs

_LOOK_S = 5.0  # how often the driver asks how large the cluster is: nodes come and go
_CANCEL_S = 5.0  # what tasks that are stopped have to remove their unfinished files
_STORE_BYTES = 100 * 2**20  # of a local start: only the settings go through Ray's object store
# The sums of BLAS depend on its threads: see design.md. It reads this when it is loaded.
_ENVIRONMENT = {"env_vars": {"OPENBLAS_NUM_THREADS": "1"}}


class RayExecutor:
    """Make shards on a Ray cluster."""

    def __init__(self, address: str | None) -> None:
        """Take the address of the cluster.

        Args:
            address: As `ray.init` takes it; None takes the variable `RAY_ADDRESS`, or starts Ray on this machine.

        Raises:
            BadSetting: Ray is not installed.
        """
        try:
            import ray
        except ImportError:
            raise BadSetting("--on ray needs the package ray; run: pip install 'upvl[ray]'") from None
        self._ray = ray
        self._address = address or os.environ.get("RAY_ADDRESS") or None

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards of `work`, those of the whole dataset included."""
        with _connection(self._ray, self._address):
            driver = _Driver(self._ray, work, watch)
            yield from run_by_scope(work, driver.run)


@contextlib.contextmanager
def _connection(ray: ModuleType, address: str | None) -> Iterator[None]:
    """Connect to a cluster, or start Ray on this machine, and leave it at the end."""
    if ray.is_initialized():  # whoever calls from Python has connected to a cluster
        yield
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault(
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0"
    )  # as Ray's later versions do, without a warning
    logging.getLogger("ray").setLevel(logging.ERROR)
    options: dict[str, Any] = {"address": address}
    if address is None:
        options = {"address": "local", "include_dashboard": False, "object_store_memory": _STORE_BYTES}
    try:
        with _kept_handlers():
            ray.init(
                **options, log_to_driver=False, logging_level=logging.ERROR, runtime_env=_ENVIRONMENT
            )  # fmt: skip
    except Exception as error:  # Ray has no class of its own for this
        where = f"the Ray cluster at {address} cannot be reached" if address else "Ray cannot be started here"
        raise UpvlError(f"--on ray: {where}: {one_line(error)[:300]}; see: ray status") from error
    _silence()
    try:
        yield
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _kept_handlers() -> Iterator[None]:
    """Give the handlers of signals back, which Ray replaces by its own."""
    numbers = [signal.SIGINT, signal.SIGTERM] if threading.current_thread() is threading.main_thread() else []
    handlers = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


def _silence() -> None:
    """Keep Ray from writing over the display that a worker died: the driver reports it where it matters."""
    with contextlib.suppress(ImportError, AttributeError, KeyError):
        from ray._private.ray_logging import global_worker_stdstream_dispatcher

        global_worker_stdstream_dispatcher.remove_handler("ray_print_logs")


@dataclass
class _Task:
    """Stages of a drive that run as one task, and those that come after it.

    Attributes:
        job: The drive and the stages of this task.
        later: The tasks that follow on the same drive.
        node: The node of the one before, which may hold what it made in its cache; None for any.
        stage: The stage that it is at.
        deaths: How many workers died at this stage.
        failed: Whether the drive cannot be gone on with.
    """

    job: Job
    later: list[tuple[str, ...]]
    node: str | None = None
    stage: str = ""
    deaths: int = 0
    failed: bool = False


class _Driver:
    """Gives out tasks, a bounded number at a time, and takes what they report."""

    def __init__(self, ray: ModuleType, work: Work, watch: Watch) -> None:
        self._ray = ray
        self._watch = watch
        self._needs = {stage.name: stage.needs for stage in work.stages}
        self._parcel = ray.put(Parcel.of(work))
        # Ray Client, which ray:// addresses use, has no streams: a task then reports when it ends.
        self._streams = not ray.util.client.ray.is_connected()
        self._largest: dict[str, float] = {}
        self._room = 0
        self._looked_s = 0.0

    def run(self, jobs: Iterable[Job]) -> Iterator[Made | Failed]:
        """Run jobs; those that have begun go first, so that the drives that are half done are few."""
        jobs = iter(jobs)
        ready: deque[_Task] = deque()
        running: dict[Any, _Task] = {}
        try:
            while True:
                self._look()
                while len(running) < self._room:
                    task = ready.popleft() if ready else self._first(next(jobs, None))
                    if task is None:
                        break
                    running[self._submit(task)] = task
                if not running:
                    return
                for reference in self._reporting(list(running)):
                    task = running[reference]
                    yield from self._take(reference, task, running, ready)
        finally:
            self._cancel(list(running))

    def _first(self, job: Job | None) -> _Task | None:
        if job is None:
            return None
        first, *later = self._split(job.stages)
        return _Task(Job(job.segment, first, job.check), later)

    def _split(self, stages: tuple[str, ...]) -> list[tuple[str, ...]]:
        """Return runs of stages for the same kind of machine: with a GPU or without, where the cluster has any."""
        has_gpus = bool(self._largest.get("GPU"))
        return [
            tuple(run) for _, run in groupby(stages, lambda name: has_gpus and self._needs[name].gpus > 0)
        ]

    def _look(self) -> None:
        """Ask now and then how large the cluster and its largest node are."""
        if time.monotonic() - self._looked_s < _LOOK_S and self._room:
            return
        nodes = [node["Resources"] for node in self._ray.nodes() if node["Alive"]]
        for name in ("CPU", "GPU", "memory"):
            self._largest[name] = max((node.get(name, 0.0) for node in nodes), default=0.0)
        cores = sum(node.get("CPU", 0.0) for node in nodes)
        # Twice as many tasks as can run: the next waits at its node, and an autoscaler sees what is wanted.
        self._room = max(4, round(2 * cores))
        self._looked_s = time.monotonic()

    def _submit(self, task: _Task) -> Any:
        needs = self._clipped(task.job.stages)
        options: dict[str, Any] = {
            "num_cpus": needs.cpus, "num_gpus": needs.gpus, "max_retries": 0,
            "memory": int(needs.memory_gib * 2**30), "name": f"{task.job.stages[0]} {task.job.segment}",
        }  # fmt: skip
        if task.node:
            from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

            options["scheduling_strategy"] = NodeAffinitySchedulingStrategy(
                task.node, soft=True, _spill_on_unavailable=True
            )
        if self._streams:
            options["num_returns"] = "streaming"
        function = self._ray.remote(run_task if self._streams else run_task_at_once)
        return function.options(**options).remote(self._parcel, task.job, needs.cpus)

    def _clipped(self, stages: tuple[str, ...]) -> Needs:
        """Return what the stages of a task need, and no more than the largest node has: it has to run somewhere."""
        wanted = [self._needs[name] for name in stages]
        largest = self._largest
        return Needs(
            max(1, min(max(needs.cpus for needs in wanted), int(largest["CPU"] or 2**16))),
            min(max(needs.gpus for needs in wanted), largest["GPU"]),
            min(max(needs.memory_gib for needs in wanted), (largest["memory"] or 2.0**50) / 2**30),
        )

    def _reporting(self, references: list[Any]) -> list[Any]:
        """Return the tasks that have something to report, after a while where there is none."""
        found, _ = self._ray.wait(references, num_returns=1, timeout=_LOOK_S, fetch_local=False)
        if not found:
            return []
        all_found, _ = self._ray.wait(references, num_returns=len(references), timeout=0, fetch_local=False)
        return list(all_found)

    def _take(
        self, reference: Any, task: _Task, running: dict[Any, _Task], ready: deque[_Task]
    ) -> Iterator[Made | Failed]:
        """Take one report of a task, and put what follows from it into `ready`."""
        errors = self._ray.exceptions
        try:
            report = self._ray.get(next(reference) if self._streams else reference)
        except StopIteration:
            report = None
        except errors.RayTaskError as error:  # a bug, with the traceback of the worker in its message
            raise error.cause from error
        except errors.RayError as error:  # a process, its node or what it yielded is lost
            del running[reference]
            yield from self._again(task, error, ready)
            return
        for event in report or ():
            if isinstance(event, Arrived):
                task.node = event.node
            elif isinstance(event, Started):
                task.stage = event.stage
                self._watch.started(event)
            elif isinstance(event, Warned):
                self._watch.warned(event)
            else:
                task.deaths = 0
                task.failed |= isinstance(event, Failed)
                yield event
        if report is None or not self._streams:
            del running[reference]
            if task.later and not task.failed:
                ready.append(_Task(Job(task.job.segment, task.later[0]), task.later[1:], task.node))

    def _again(self, task: _Task, error: Exception, ready: deque[_Task]) -> Iterator[Failed]:
        """Begin a task again whose worker died; its finished shards are found fresh."""
        task.deaths += 1
        if task.deaths < ATTEMPTS:
            task.node = None
            ready.append(task)
            return
        cause = f"its worker was lost ({type(error).__name__})"
        stage = task.stage or task.job.stages[0]
        yield lost_job(task.job.segment, stage, cause, "see: ray status, and give its nodes more memory")

    def _cancel(self, references: list[Any]) -> None:
        """Stop tasks after a failure or Ctrl-C, so that they remove their unfinished files."""
        if not references:
            return
        with contextlib.suppress(Exception):  # the cluster may be what has failed
            for reference in references:
                self._ray.cancel(reference, force=False, recursive=False)
            self._ray.wait(references, num_returns=len(references), timeout=_CANCEL_S, fetch_local=False)
