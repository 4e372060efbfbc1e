"""What all executors share: the work, its jobs, and what they report."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Protocol

from upvl_cli.config.base import Config
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.pipeline import AnyStage, Pipeline
from upvl_cli.pipeline.runner import Made, Tick, make_shard
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.pipeline.workspace import Workspace

# A job whose processes died that often at one shard is given up: too little memory for a drive kills all of them.
ATTEMPTS = 4


@dataclass(frozen=True)
class Place:
    """What a worker needs to open a workspace again.

    Attributes:
        pipeline: The stages, datasets and models.
        stages: Folder of the settings.
        out: Folder of the shards.
        preset: The preset of the run.
        folder: Where the run was started; relative paths in the settings start there.
    """

    pipeline: Pipeline
    stages: Path
    out: Path
    preset: str
    folder: Path

    @classmethod
    def of(cls, workspace: Workspace) -> Place:
        """Return the place of a workspace that is open in this process."""
        return cls(workspace.pipeline, workspace.stages, workspace.out, workspace.preset, Path(os.getcwd()))

    def open(self) -> Workspace:
        """Open the workspace."""
        return Workspace(self.pipeline, self.stages, self.out, self.preset)


# What is asked of a drive before anything is made of it: yields what is suspicious, a line each, and raises UpvlError
# where the drive is not to be gone on with. A function of a module, or a partial of one: other processes are sent it.
FirstCheck = Callable[[Workspace, str], Iterable[str]]
CHECK = "check"  # its name among those of stages


@dataclass(frozen=True)
class Job:
    """Consecutive stages of one drive, or of the whole dataset: one shard for each stage.

    Attributes:
        segment: The drive.
        stages: Names of the stages.
        check: What is asked of the drive before them; None asks nothing.
    """

    segment: str
    stages: tuple[str, ...]
    check: FirstCheck | None = None


@dataclass(frozen=True)
class Started:
    """A worker has begun with a shard."""

    stage: str
    segment: str
    where: str


@dataclass(frozen=True)
class Warned:
    """Something suspicious in a drive that is gone on with."""

    segment: str
    text: str


@dataclass(frozen=True)
class Failed:
    """A drive that cannot be gone on with, and why; the others can."""

    stage: str
    segment: str
    error: UpvlError


class Watch(Protocol):
    """Who follows a run, to show how far it is."""

    def tick(self, frames: int = 1) -> None:
        """Count frames that are done."""

    def started(self, started: Started) -> None:
        """Note what a worker has begun with."""

    def warned(self, warned: Warned) -> None:
        """Note what is suspicious in a drive."""

    def failed(self, failed: Failed) -> None:
        """Note a drive that failed."""


class Unwatched:
    """A `Watch` that shows nothing."""

    def tick(self, frames: int = 1) -> None:
        """Count nothing."""

    def started(self, started: Started) -> None:
        """Note nothing."""

    def warned(self, warned: Warned) -> None:
        """Note nothing."""

    def failed(self, failed: Failed) -> None:
        """Note nothing."""


@dataclass(frozen=True)
class Work:
    """The shards of some stages on some drives.

    Attributes:
        workspace: The workspace of the shards, as it is open in this process.
        stages: The stages, each after those it reads.
        segments: Names of the drives.
        settings: Values of each stage, by its name.
        chosen: Names of the drives of the command, those included that are known to be fresh; a queue, whose tasks run
            the command in shares, counts its shares over them. Empty where they are `segments`.
        check: What is asked of each drive before its first stage; None asks nothing.
    """

    workspace: Workspace
    stages: tuple[AnyStage, ...]
    segments: Sequence[str]
    settings: Mapping[str, Config]
    chosen: Sequence[str] = ()
    check: FirstCheck | None = None


class Executor(Protocol):
    """Where shards are made."""

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards that are not fresh; yield each as it is finished, and each drive that failed.

        Raises:
            UpvlError: No drive can be gone on with, as where a stage of the whole dataset failed.
        """


def run_by_scope(
    work: Work, run_jobs: Callable[[Iterable[Job]], Iterator[Made | Failed]]
) -> Iterator[Made | Failed]:
    """Run a job a drive for the stages between two of the whole dataset, and one job for each run of these.

    Args:
        work: The shards to make.
        run_jobs: Takes jobs that do not depend on each other, one by one as it has room for them, and yields what they
            made; ends when all are done.
    """
    failed: set[str] = set()
    check = work.check
    for is_of_dataset, group in groupby(work.stages, key=lambda stage: stage.is_of_dataset):
        if failed and len(failed) == len(work.segments):
            return
        names = tuple(stage.name for stage in group)
        segments = [WHOLE_DATASET] if is_of_dataset else work.segments
        asked, check = (None, check) if is_of_dataset else (check, None)
        for event in run_jobs(Job(segment, names, asked) for segment in segments if segment not in failed):
            if isinstance(event, Failed):
                if is_of_dataset:
                    raise event.error
                failed.add(event.segment)
            yield event


def run_job(
    workspace: Workspace, job: Job, settings: Mapping[str, Config], where: str, tick: Tick
) -> Iterator[Started | Warned | Made | Failed]:
    """Check the drive of a job and make its shards, in this process; a failure that a user can mend ends it.

    Args:
        workspace: The workspace of the shards.
        job: The drive and its stages.
        settings: Values of each stage, by its name.
        where: Name of the worker, for those who watch.
        tick: Called after each frame.
    """
    if job.check is not None:
        yield Started(CHECK, job.segment, where)
        try:
            for text in job.check(workspace, job.segment):
                yield Warned(job.segment, text)
        except UpvlError as error:
            yield Failed(CHECK, job.segment, error)
            return
    for name in job.stages:
        yield Started(name, job.segment, where)
        stage = workspace.pipeline.by_name[name]
        try:
            yield make_shard(workspace, stage, job.segment, settings[name], tick)
        except UpvlError as error:
            yield Failed(name, job.segment, error)
            return


def lost_job(segment: str, stage: str, cause: str, remedy: str) -> Failed:
    """Return the failure of a job whose workers died again and again at the same shard.

    Args:
        segment: The drive.
        stage: The stage that they had begun with.
        cause: What became of its workers, such as "its process was killed".
        remedy: What the user can do.
    """
    return Failed(stage, segment, UpvlError(f"{stage}: {cause} {ATTEMPTS} times in {segment}; {remedy}"))
