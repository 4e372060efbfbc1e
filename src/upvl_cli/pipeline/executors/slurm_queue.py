"""Make shards by a job array of a SLURM queue: each task runs this command with its share of the drives."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.catalog.tasks import fresh_segments
from upvl_cli.pipeline.executors.base import ATTEMPTS, Failed, Started, Watch, Work
from upvl_cli.pipeline.executors.share import Share
from upvl_cli.pipeline.executors.slurm_options import SlurmOptions, array_script
from upvl_cli.pipeline.executors.slurm_task import run_command
from upvl_cli.pipeline.runner import Made, state
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.storage.remote_path import is_remote
from upvl_cli.runtime.parallel import threads

_POLL_S = 5.0  # a queue is asked for its jobs that often
_LOCAL_POLL_S = 0.2
_CANCEL_S = 10.0
_STOPPED = 130


@dataclass(frozen=True)
class QueueCommand:
    """The command that a queue runs in shares.

    Attributes:
        words: The words after `upvl`, without what says where to run.
        options: What each task asks for.
        is_local: Whether the array runs on this machine, without SLURM.
    """

    words: tuple[str, ...]
    options: SlurmOptions
    is_local: bool = False


class SlurmExecutor:
    """Make shards by a job array."""

    def __init__(self, command: QueueCommand) -> None:
        """Take the command.

        Raises:
            BadSetting: submitit is not installed, or this machine cannot submit jobs.
        """
        try:
            import submitit
        except ImportError:
            raise BadSetting(
                "--on slurm needs the package submitit; run: pip install 'upvl[slurm]'"
            ) from None
        if not command.is_local and shutil.which("sbatch") is None:
            raise BadSetting(
                "--on slurm: this machine has no sbatch; run it where jobs are submitted, or print its script: "
                "--dry-run"
            )
        self._submitit = submitit
        self._command = command

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards of `work`: one array for all stages; a task that dies is submitted again."""
        options = sized_options(self._command, work)
        queue = _Queue(self._submitit, self._command, options, work.workspace.out)
        log = _LogReader(work.workspace.out)
        made: set[tuple[str, str]] = set()
        asked = {WHOLE_DATASET, *work.segments}
        for done in queue.run(watch):
            for shard in log.new_shards():
                if shard.segment in asked:
                    made.add((shard.stage, shard.segment))
                    yield shard
            if done:
                break
        yield from _verified(work, made, queue.messages, options.tasks)


def sized_options(command: QueueCommand, work: Work) -> SlurmOptions:
    """Return what the tasks ask for; an array has no more than there are drives, or cores on this machine."""
    drives = 1 if all(stage.is_of_dataset for stage in work.stages) else max(1, len(work.segments))
    return command.options.for_stages(work.stages, min(drives, threads()) if command.is_local else drives)


def script_of(command: QueueCommand, work: Work) -> str:
    """Return the script of the array, as `sbatch` takes it."""
    return array_script(sized_options(command, work), command.words, Path(os.getcwd()))


def _queue_folder(out: Path) -> Path:
    """Return where a queue keeps its files: beside the shards, or in the current folder where those are remote."""
    return (Path(os.getcwd()) if is_remote(out) else out) / "slurm"


class _Queue:
    """The tasks of one array, and which of them ended how."""

    def __init__(self, submitit: Any, command: QueueCommand, options: SlurmOptions, out: Path) -> None:
        self._command = command
        self._options = options
        self.messages: dict[int, str] = {}  # of shares in which drives failed
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

    def run(self, watch: Watch) -> Iterator[bool]:
        """Submit all shares, and yield now and then; True when all have ended."""
        deaths = dict.fromkeys(range(1, self._options.tasks + 1), 0)
        running = self._submit(list(deaths), deaths, watch)
        try:
            while running:
                yield False
                time.sleep(_LOCAL_POLL_S if self._command.is_local else _POLL_S)
                again = []
                for number in [number for number, job in running.items() if job.done()]:
                    del running[number]
                    if self._is_lost(number, deaths):
                        again.append(number)
                running |= self._submit(again, deaths, watch)
            yield True
        finally:
            self._cancel(list(running.values()))

    def _submit(self, numbers: Sequence[int], deaths: dict[int, int], watch: Watch) -> dict[int, Any]:
        if not numbers:
            return {}
        shares = [Share(number, self._options.tasks) for number in numbers]
        has_shares = self._options.tasks > 1
        commands = [
            [*self._command.words, *(["--shard", f"{share.number}/{share.count}"] if has_shares else [])]
            for share in shares
        ]
        count = len(numbers)
        jobs = self._executor.map_array(
            run_command, commands, [os.getcwd()] * count, [str(self._options.cpus)] * count,
            [str(self._result(number, deaths[number])) for number in numbers],
        )  # fmt: skip
        for share, job in zip(shares, jobs, strict=True):
            where = f"job {job.job_id}"
            watch.started(Started("share", f"{share.number}/{share.count}", where))
        return dict(zip(numbers, jobs, strict=True))

    def _result(self, number: int, attempt: int) -> Path:
        return self._folder / f"share-{number}-{attempt}.json"

    def _is_lost(self, number: int, deaths: dict[int, int]) -> bool:
        """Return whether a share that has ended is to be submitted again."""
        try:
            result = json.loads(self._result(number, deaths[number]).read_bytes())
            code, message = int(result["code"]), str(result["message"])
        except (OSError, ValueError, KeyError):
            code, message = _STOPPED, "its task was killed, or its node was lost"
        if code == 0:
            return False
        if code != _STOPPED:
            self.messages[number] = message.removeprefix("upvl: ")
            return False
        deaths[number] += 1
        if deaths[number] < ATTEMPTS:
            return True
        self.messages[number] = f"its task was ended {ATTEMPTS} times; the logs are in {self._folder}"
        return False

    def _cancel(self, jobs: Sequence[Any]) -> None:
        for job in jobs:
            with contextlib.suppress(Exception):  # it may have ended by itself
                job.cancel(check=False)
        end_s = time.monotonic() + _CANCEL_S
        while time.monotonic() < end_s and not all(job.done() for job in jobs):
            time.sleep(_LOCAL_POLL_S)


class _LogReader:
    """The shards that are written to the run log of a local folder from now on; none of an object store's."""

    def __init__(self, out: Path) -> None:
        self._path = None if is_remote(out) else out / "runs.jsonl"
        self._read = self._path.stat().st_size if self._path and self._path.is_file() else 0

    def new_shards(self) -> Iterator[Made]:
        """Yield the shards that were made since the last call."""
        if self._path is None or not self._path.is_file():
            return
        with self._path.open("rb") as file:
            file.seek(self._read)
            for line in file:
                if not line.endswith(b"\n"):
                    return  # its end is being written
                self._read += len(line)
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    entry = json.loads(line)
                    stage, segment = str(entry["stage"]), str(entry["segment"])
                    yield Made(stage, segment, False, int(entry["rows"]), {}, float(entry["seconds"]), 0.0)


def _verified(
    work: Work, made: set[tuple[str, str]], messages: dict[int, str], tasks: int
) -> Iterator[Made | Failed]:
    """Yield the shards that were fresh before, and the drives whose shards are not fresh, with why."""
    failed: set[str] = set()
    number_of = {
        segment: number
        for number in range(1, tasks + 1)
        for segment in Share(number, tasks).of(work.chosen or work.segments)
    }
    fresh = fresh_segments(work.workspace, work.stages, work.segments, work.settings)
    for stage in work.stages:
        for segment in [WHOLE_DATASET] if stage.is_of_dataset else work.segments:
            if (stage.name, segment) in made or segment in failed:
                continue
            if segment in fresh:
                yield Made.found_fresh(stage.name, segment)
                continue
            condition, reason = state(work.workspace, stage, segment, work.settings[stage.name])
            if condition == "fresh":
                yield Made.found_fresh(stage.name, segment)
                continue
            failed.add(segment)
            message = messages.get(number_of.get(segment, 1)) or f"{stage.name} is {condition} ({reason})"
            yield Failed(stage.name, segment, UpvlError(message))
