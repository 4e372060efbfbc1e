"""Make shards in this process, one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from upvl_cli.pipeline.executors.base import Failed, Job, Started, Warned, Watch, Work, run_by_scope, run_job
from upvl_cli.pipeline.runner import Made


class SerialExecutor:
    """Make shards in this process."""

    def run(self, work: Work, watch: Watch) -> Iterator[Made | Failed]:
        """Make the shards of `work`."""
        return run_by_scope(work, lambda jobs: run_here(work, jobs, watch))


def run_here(work: Work, jobs: Iterable[Job], watch: Watch) -> Iterator[Made | Failed]:
    """Run jobs in this process."""
    for job in jobs:
        for event in run_job(work.workspace, job, work.settings, "here", watch.tick):
            if isinstance(event, Started):
                watch.started(event)
            elif isinstance(event, Warned):
                watch.warned(event)
            else:
                yield event
