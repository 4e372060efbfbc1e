"""Run stages on drives, wherever an executor makes their shards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.catalog.catalog import Reading
from upvl_cli.pipeline.catalog.tasks import fresh_segments
from upvl_cli.pipeline.executors.base import Executor, Failed, FirstCheck, Unwatched, Watch, Work
from upvl_cli.pipeline.executors.reports import reporting
from upvl_cli.pipeline.executors.serial import SerialExecutor
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.runner import Made, claim_folder
from upvl_cli.pipeline.workspace import Workspace

# From so many drives on all of them are compared at once, by listings and the catalogue; below, one by one is as quick.
_MANY = 32
_MOST_NAMED = 10  # drives that failed, in one line


def run_all(
    workspace: Workspace,
    stages: Sequence[AnyStage],
    segments: Sequence[str],
    *,
    overrides: Mapping[str, object],
    executor: Executor | None = None,
    watch: Watch | None = None,
    check: FirstCheck | None = None,
    part: str = "",
) -> Iterator[Made]:
    """Run stages, in order, on each drive; yields as shards are made.

    Args:
        workspace: The workspace of the shards.
        stages: The stages to run, each after those it reads.
        segments: Names of the drives.
        overrides: Values of the command line, for a single stage.
        executor: Where the shards are made; None makes them in this process.
        watch: Who follows the run; None shows nothing.
        check: What is asked of each drive before its first stage; None asks nothing.
        part: Name of this run among others that work on other drives at the same time, for its file of the catalogue.

    Raises:
        UpvlError: Drives failed; raised after the others are done.
    """
    settings = {stage.name: claim_folder(workspace, stage, overrides) for stage in stages}
    watch = watch or Unwatched()
    failures: dict[str, UpvlError] = {}
    left = segments
    if len(segments) >= _MANY:
        fresh = fresh_segments(workspace, stages, segments, settings, Reading(part))
        left = [segment for segment in segments if segment not in fresh]
        for segment in (name for name in segments if name in fresh):
            yield from (Made.found_fresh(stage.name, segment) for stage in stages if not stage.is_of_dataset)
    work = Work(workspace, tuple(stages), left, settings, segments, check)
    for event in reporting(executor or SerialExecutor()).run(work, watch):
        if isinstance(event, Failed):
            failures[event.segment] = event.error
            watch.failed(event)
        else:
            yield event
    _raise_failures(failures, len(segments))


def _raise_failures(failures: Mapping[str, UpvlError], segments: int) -> None:
    """Raise the errors of drives that failed, after the others have been made."""
    if segments == 1 and failures:
        raise next(iter(failures.values()))
    if failures:
        named = sorted(failures.items())[:_MOST_NAMED]
        reasons = "; ".join(
            f"{segment}: {str(error).removeprefix(f'{segment}: ')}" for segment, error in named
        )
        others = ", the others are done" if len(failures) < segments else ""
        more = (
            f"; and {len(failures) - len(named)} more, named by the same command once these are mended"
            if len(failures) > len(named)
            else ""
        )
        raise UpvlError(f"{len(failures)} of {segments} drives failed{others}. {reasons}{more}")
