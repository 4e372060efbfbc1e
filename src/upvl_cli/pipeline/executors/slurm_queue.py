"""Make shards by a job array of a SLURM queue: each task runs this command with its share of the drives."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from upvl_cli.errors import BadSetting, UpvlError
from upvl_cli.pipeline.catalog.tasks import fresh_segments
from upvl_cli.pipeline.executors.base import Failed, Watch, Work
from upvl_cli.pipeline.executors.job_array import JobArray, QueueCommand
from upvl_cli.pipeline.executors.slurm_options import SlurmOptions, array_script
from upvl_cli.pipeline.runner import Made, state
from upvl_cli.pipeline.stage import WHOLE_DATASET
from upvl_cli.runtime.parallel import threads


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
        """Make the shards of `work`: one array for all stages; a task that is lost is submitted again."""
        options = sized_options(self._command, work)
        array = JobArray(self._submitit, self._command, options, work.workspace.out)
        made: set[tuple[str, str]] = set()
        asked = {WHOLE_DATASET, *work.segments}
        for shard in array.run(work.chosen or work.segments, watch):
            if shard.segment in asked and (shard.stage, shard.segment) not in made:
                made.add((shard.stage, shard.segment))
                yield shard
        yield from _verified(work, made, array.reasons)


def sized_options(command: QueueCommand, work: Work) -> SlurmOptions:
    """Return what the tasks ask for; an array has no more than there are drives, or cores on this machine."""
    drives = 1 if all(stage.is_of_dataset for stage in work.stages) else max(1, len(work.segments))
    return command.options.for_stages(work.stages, min(drives, threads()) if command.is_local else drives)


def script_of(command: QueueCommand, work: Work) -> str:
    """Return the script of the array, as `sbatch` takes it."""
    return array_script(sized_options(command, work), command.words, Path(os.getcwd()))


def _verified(work: Work, made: set[tuple[str, str]], reasons: Mapping[str, str]) -> Iterator[Made | Failed]:
    """Yield the shards that no task reported but are fresh, and the drives whose shards are not, with why.

    Raises:
        UpvlError: A shard of the whole dataset is not fresh, though those that it is made from are.
    """
    failed: set[str] = set()
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
            error = UpvlError(reasons.get(segment) or f"{stage.name} is {condition} ({reason})")
            if stage.is_of_dataset and failed:
                continue  # for want of those
            if stage.is_of_dataset:
                raise error
            failed.add(segment)
            yield Failed(stage.name, segment, error)
