"""A job array of a SLURM queue: a task for each share of the drives, submitted again where it was lost."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from upvl_cli.pipeline.executors.base import ATTEMPTS, Failed, Started, Warned, Watch, lost_job
from upvl_cli.pipeline.executors.reports import ReportReader
from upvl_cli.pipeline.executors.share import Share
from upvl_cli.pipeline.executors.slurm_options import SlurmOptions
from upvl_cli.pipeline.executors.slurm_task import run_command
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.storage.remote_path import is_remote

_POLL_S = 5.0  # a queue is asked for its jobs that often
_LOCAL_POLL_S = 0.2
_CANCEL_S = 10.0
_MENDABLE, _STOPPED = 2, 130  # exit codes of upvl


@dataclass(frozen=True)
class QueueCommand:
    """The command that a queue runs in shares.

    Attributes:
        program: The words that start `upvl` on any node.
        words: The words after them, without what says where to run.
        options: What each task asks for.
        is_local: Whether the array runs on this machine, without SLURM.
    """

    program: tuple[str, ...]
    words: tuple[str, ...]
    options: SlurmOptions
    is_local: bool = False


@dataclass(frozen=True)
class _ShareTask:
    """A share that was submitted.

    Attributes:
        share: Its drives.
        job: The job of submitit.
        result: The file that it leaves when it ends by itself.
        reports: What it is at.
    """

    share: Share
    job: Any
    result: Path
    reports: ReportReader

    def ending(self) -> tuple[int, str]:
        """Return the exit code and the last line of a task that has ended; one that was killed has left none."""
        try:
            result = json.loads(self.result.read_bytes())
            return int(result["code"]), str(result["message"]).removeprefix("upvl: ")
        except (OSError, ValueError, KeyError):
            return _STOPPED, ""


class JobArray:
    """The tasks of one array, and the drives that they gave up.

    Attributes:
        reasons: Why drives were given up, by name.
    """

    def __init__(self, submitit: Any, command: QueueCommand, options: SlurmOptions, out: Path) -> None:
        """Submit nothing yet.

        Args:
            submitit: The module.
            command: What the tasks run.
            options: What each task asks for.
            out: Folder of the shards.
        """
        self._command = command
        self._options = options
        # Of tasks, by the stage and drive that they were at.
        self._deaths: Counter[tuple[str, str]] = Counter()
        self._numbers = count(1)  # of tasks: a share that is submitted again has files of its own
        self.reasons: dict[str, str] = {}
        # submitit keeps files there that it unpickles: nobody else may write into it.
        folder = _queue_folder(out)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
        self._folder = (folder / secrets.token_hex(4)).absolute()
        self._folder.mkdir(mode=0o700)
        self._executor = submitit.AutoExecutor(self._folder, cluster="local" if command.is_local else "slurm")
        named = {"partition": options.partition, "account": options.account, "qos": options.qos}
        slurm: dict[str, str | int] = {f"slurm_{name}": value for name, value in named.items() if value}
        if not command.is_local:
            slurm["slurm_array_parallelism"] = options.tasks
        self._executor.update_parameters(
            name="upvl", timeout_min=options.time, mem_gb=options.memory, cpus_per_task=options.cpus,
            gpus_per_node=options.gpus, **slurm,
        )  # fmt: skip

    def run(self, segments: Sequence[str], watch: Watch) -> Iterator[Made]:
        """Run all shares of the drives to their end; yield the shards that their tasks report.

        Raises:
            UpvlError: A stage of the whole dataset has cost too many tasks.
        """
        waiting = deque(Share(number, self._options.tasks) for number in range(1, self._options.tasks + 1))
        running: list[_ShareTask] = []
        try:
            while waiting or running:
                room = min(len(waiting), self._options.tasks - len(running))
                running += self._submit([waiting.popleft() for _ in range(room)], watch)
                time.sleep(_LOCAL_POLL_S if self._command.is_local else _POLL_S)
                for task in list(running):
                    has_ended = task.job.done()  # asked first: what it reports afterwards is all of it
                    yield from self._take_reports(task, watch)
                    if has_ended:
                        running.remove(task)
                        waiting += self._again(task, segments)
        finally:
            self._cancel([task.job for task in running])

    def _submit(self, shares: Sequence[Share], watch: Watch) -> list[_ShareTask]:
        if not shares:
            return []
        names = [f"task-{next(self._numbers)}-share-{share.number}-of-{share.count}" for share in shares]
        results = [self._folder / f"{name}.json" for name in names]
        reports = [self._folder / f"{name}.jsonl" for name in names]
        commands = [[*self._command.program, *self._command.words, *_shard_words(share)] for share in shares]
        jobs = self._executor.map_array(
            run_command, commands, [os.getcwd()] * len(shares), [str(self._options.cpus)] * len(shares),
            list(map(str, results)), list(map(str, reports)),
        )  # fmt: skip
        tasks = []
        for share, job, result, path in zip(shares, jobs, results, reports, strict=True):
            where = f"job {job.job_id}"
            watch.started(Started("share", f"{share.number}/{share.count}", where))
            tasks.append(_ShareTask(share, job, result, ReportReader(path, where)))
        return tasks

    def _take_reports(self, task: _ShareTask, watch: Watch) -> Iterator[Made]:
        for event in task.reports.new():
            if isinstance(event, int):
                watch.tick(event)
            elif isinstance(event, Started):
                watch.started(event)
            elif isinstance(event, Warned):
                watch.warned(event)
            elif isinstance(event, Failed):
                self.reasons[event.segment] = str(event.error)
            else:
                if not event.fresh:  # tasks that were ended before one came this far at least
                    del self._deaths[_between_shards(task.share)]
                yield event

    def _again(self, task: _ShareTask, segments: Sequence[str]) -> list[Share]:
        """Return the shares to submit in place of a task that has ended.

        A drive that has cost too many tasks is left out.

        Raises:
            UpvlError: It was at a stage of the whole dataset, which has cost too many tasks.
        """
        code, message = task.ending()
        if code == 0:
            return []
        share = task.share
        if code != _STOPPED:
            if code != _MENDABLE:
                message = (
                    f"a task ended with {message or f'exit code {code}'}; its traceback is in {self._folder}"
                )
            for segment in (WHOLE_DATASET, *share.of(segments)):
                self.reasons.setdefault(segment, message)
            return []
        place = stage, segment = task.reports.at or _between_shards(share)
        self._deaths[place] += 1
        if self._deaths[place] < ATTEMPTS:
            return [share]
        if not stage:
            message = (
                f"its task was ended {ATTEMPTS} times before a shard was made; the logs are in {self._folder}"
            )
            for segment in share.of(segments):
                self.reasons[segment] = message
            return []
        remedy = f"ask for more with --slurm memory=GIB,time=MINUTES; the logs are in {self._folder}"
        lost = lost_job(segment, stage, "its task was ended", remedy)
        if segment == WHOLE_DATASET:
            raise lost.error
        self.reasons[segment] = str(lost.error)
        return share.without(segment, segments)

    def _cancel(self, jobs: Sequence[Any]) -> None:
        for job in jobs:
            with contextlib.suppress(Exception):  # it may have ended by itself
                job.cancel(check=False)
        end_s = time.monotonic() + _CANCEL_S
        while time.monotonic() < end_s and not all(job.done() for job in jobs):
            time.sleep(_LOCAL_POLL_S)


def _shard_words(share: Share) -> list[str]:
    return ["--shard", f"{share.number}/{share.count}"] if share.count > 1 else []


def _between_shards(share: Share) -> tuple[str, str]:
    """Return the place of a task that had begun no shard, among those of shards."""
    return "", f"{share.number}/{share.count}"


def _queue_folder(out: Path) -> Path:
    """Return where a queue keeps its files: beside the shards, or in the current folder where those are remote."""
    return (Path(os.getcwd()) if is_remote(out) else out) / "slurm"
