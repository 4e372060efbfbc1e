"""Make shards in several processes of this machine; one that is killed is replaced, and its job begun again."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from upvl_cli.config.base import Config
from upvl_cli.pipeline.executors.base import (
    ATTEMPTS,
    Failed,
    Job,
    Place,
    Started,
    Warned,
    Watch,
    Work,
    lost_job,
    run_by_scope,
    run_job,
)
from upvl_cli.pipeline.executors.serial import SerialExecutor, run_here
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.runtime.parallel import THREADS_VARIABLE, prepare_worker, threads

_TICK_S = 0.5  # frames are reported that often, not one by one
_GRACE_S = 5.0  # what a worker that is stopped has to remove its unfinished file


class ProcessExecutor:
    """Make shards in some processes of this machine."""

    def __init__(self, workers: int) -> None:
        """Take the number of processes that share the drives between them."""
        self._workers = workers

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards of `work`; those of the whole dataset in this process, which has all cores for them."""
        workers = min(self._workers, len(work.segments))
        if workers <= 1:
            yield from SerialExecutor().run(work, watch)
            return
        pool = _Pool(work, workers, watch)

        def run_jobs(jobs: Iterable[Job]) -> Iterator[Made | Failed]:
            for job in (jobs := iter(jobs)):
                if job.segment == WHOLE_DATASET:
                    yield from run_here(work, [job], watch)
                else:
                    yield from pool.run(_preceded(job, jobs))

        try:
            yield from run_by_scope(work, run_jobs)
        finally:
            pool.close()


def _preceded(first: Job, jobs: Iterator[Job]) -> Iterator[Job]:
    yield first
    yield from jobs


@dataclass
class _Worker:
    """A process, this end of the pipe to it, the job that it has and the stage that it is at."""

    process: BaseProcess
    pipe: Connection
    job: Job
    stage: str = ""


class _Pool:
    """Processes with a job each."""

    def __init__(self, work: Work, workers: int, watch: Watch) -> None:
        self._setup = (
            Place.of(work.workspace),
            dict(work.settings),
            max(1, threads() // workers),
            os.getpid(),
        )
        self._size = workers
        self._watch = watch
        self._busy: dict[Connection, _Worker] = {}
        self._idle: list[_Worker] = []
        self._started = 0

    def run(self, jobs: Iterator[Job]) -> Iterator[Made | Failed]:
        """Run jobs, each in a process that is free."""
        again: deque[Job] = deque()
        deaths: Counter[Job] = Counter()
        while True:
            while len(self._busy) < self._size and (job := again.popleft() if again else next(jobs, None)):
                self._give(job)
            if not self._busy:
                return
            for pipe in wait(list(self._busy)):
                worker = self._busy[pipe]  # type: ignore[index]
                try:
                    event = worker.pipe.recv()
                except (EOFError, OSError):  # killed, by a person or for want of memory
                    self._drop(worker)
                    deaths[worker.job] += 1
                    if deaths[worker.job] < ATTEMPTS:
                        again.append(worker.job)
                    else:
                        yield _lost(worker)
                    continue
                if isinstance(event, (Made, Failed)):
                    del deaths[worker.job]  # those that died came this far at least
                    yield event
                else:
                    self._note(worker, event)

    def _note(self, worker: _Worker, event: object) -> None:
        """Take what a worker reports beside its shards."""
        if event is None:
            self._idle.append(self._busy.pop(worker.pipe))
        elif isinstance(event, int):
            self._watch.tick(event)
        elif isinstance(event, Started):
            worker.stage = event.stage
            self._watch.started(event)
        elif isinstance(event, Warned):
            self._watch.warned(event)
        elif isinstance(event, BaseException):
            raise event

    def _give(self, job: Job) -> None:
        while self._idle:
            worker = self._idle.pop()
            try:
                worker.pipe.send(job)
            except OSError:  # killed while it had nothing to do
                self._end(worker)
                continue
            worker.job, worker.stage = job, ""
            self._busy[worker.pipe] = worker
            return
        self._started += 1
        # Spawned, not forked: threads of numerical libraries do not survive a fork.
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        where = f"process {self._started}"
        process = context.Process(target=_serve, args=(there, *self._setup, where), name=where, daemon=True)
        process.start()
        there.close()  # so that this end ends with the process
        here.send(job)
        self._busy[here] = _Worker(process, here, job)

    def _drop(self, worker: _Worker) -> None:
        del self._busy[worker.pipe]
        self._end(worker)

    def _end(self, worker: _Worker) -> None:
        worker.pipe.close()
        worker.process.join(_GRACE_S)

    def close(self) -> None:
        """Stop all processes; one that is at work removes its unfinished file."""
        workers = [*self._busy.values(), *self._idle]
        for worker in workers:
            worker.process.terminate()
        end_s = time.monotonic() + _GRACE_S
        for worker in workers:
            worker.pipe.close()
            worker.process.join(max(0.0, end_s - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()


def _lost(worker: _Worker) -> Failed:
    remedy = "run it with fewer --workers, or where more memory is free"
    stage = worker.stage or worker.job.stages[0]
    return lost_job(worker.job.segment, stage, "its process was killed", remedy)


class _Reporter:
    """This process's end of the pipe: events at once, frames now and then."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()  # frames may be counted by any thread
        self._frames = 0
        self._sent_s = time.monotonic()

    def tick(self) -> None:
        """Count a frame."""
        with self._lock:
            self._frames += 1
            if time.monotonic() - self._sent_s < _TICK_S:
                return
            frames, self._frames, self._sent_s = self._frames, 0, time.monotonic()
            self._pipe.send(frames)

    def send(self, event: object) -> None:
        """Report anything else."""
        with self._lock:
            self._pipe.send(event)


def _serve(
    pipe: Connection, place: Place, settings: Mapping[str, Config], cores: int, parent: int, where: str
) -> None:
    """Run the jobs that come through the pipe, until it ends."""
    prepare_worker(parent)
    os.environ[THREADS_VARIABLE] = str(cores)
    reporter = _Reporter(pipe)
    try:
        workspace = place.open()
        while True:
            job = pipe.recv()
            for event in run_job(workspace, job, settings, where, reporter.tick):
                reporter.send(event)
            reporter.send(None)
    except (EOFError, BrokenPipeError):
        return
    except Exception as error:  # a bug: the parent ends with it, and with where it was
        error.add_note(f"in {where}:\n{traceback.format_exc()}")
        reporter.send(error)
