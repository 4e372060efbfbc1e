"""Show how far a run is: a live display on a terminal, one line a shard elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from rich import progress as bars
from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table

from upvl_cli.commands.status import StageStatus
from upvl_cli.pipeline.executors.base import Failed, Started, Warned
from upvl_cli.pipeline.runner import Made

_SHOWN_WORKERS = 12  # more would leave no room on a terminal


class Progress:
    """Counts shards by stage and worker, and frames, with rate and time left."""

    def __init__(self, shards: int) -> None:
        """Start with nothing done.

        Args:
            shards: How many shards the run will make or find fresh.
        """
        self._live = sys.stderr.isatty()
        self._frames = 0
        self._fresh = 0
        self._made = 0
        self._stages: dict[str, _StageCount] = {}
        self._workers: dict[str, str] = {}
        self._bars = bars.Progress(
            bars.TextColumn("{task.description}"),
            bars.BarColumn(),
            bars.MofNCompleteColumn(),
            bars.TextColumn("shards, {task.fields[frames]} frames, {task.fields[rate]:.1f} frames/s"),
            bars.TimeRemainingColumn(),
        )
        self._task = self._bars.add_task("labelling", total=shards, frames=0, rate=0.0)
        self._display = Live(
            get_renderable=self._rendered, console=Console(stderr=True), transient=True, refresh_per_second=4
        )

    def __enter__(self) -> Self:
        """Show the display."""
        if self._live:
            self._display.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the display away and say how it ended."""
        if self._live:
            self._display.stop()
        if self._live and kind is None:
            print(f"{self._made} shards made, {self._fresh} were fresh", file=sys.stderr)

    def tick(self, frames: int = 1) -> None:
        """Count frames that are done."""
        self._frames += frames
        elapsed = self._bars.tasks[0].elapsed or 0.0
        self._bars.update(self._task, frames=self._frames, rate=self._frames / elapsed if elapsed else 0.0)

    def started(self, started: Started) -> None:
        """Note what a worker has begun with."""
        self._workers.pop(started.where, None)  # the last that began stands last
        self._workers[started.where] = f"{started.stage} {started.segment}"

    def warned(self, warned: Warned) -> None:
        """Print what is suspicious in a drive."""
        if self._live:
            self._display.console.print(warned.text, markup=False, highlight=False, soft_wrap=True)
        else:
            print(warned.text, file=sys.stderr)

    def failed(self, failed: Failed) -> None:
        """Count a drive that failed."""
        self._count(failed.stage).failed += 1

    def done(self, made: Made) -> None:
        """Count one more shard."""
        self._fresh += made.fresh
        self._made += not made.fresh
        count = self._count(made.stage)
        count.fresh += made.fresh
        count.made += not made.fresh
        count.seconds += made.seconds
        self._bars.update(self._task, advance=1, description=f"{made.stage} {made.segment}")
        if not made.fresh and not self._live:
            print(
                f"made stage={made.stage} segment={made.segment} rows={made.rows} seconds={made.seconds:.2f}"
            )

    def _count(self, stage: str) -> _StageCount:
        return self._stages.setdefault(stage, _StageCount())

    def _rendered(self) -> RenderableType:
        """Return the tables of stages and workers, where there are several workers, above the bar."""
        if len(self._workers) < 2:
            return self._bars
        stages = Table("stage", box=None, pad_edge=False)
        for name in ("made", "fresh", "failed", "s a shard"):
            stages.add_column(name, justify="right")
        for name, count in list(self._stages.items()):
            mean = f"{count.seconds / count.made:.1f}" if count.made else ""
            stages.add_row(name, str(count.made), str(count.fresh), str(count.failed), mean)
        workers = Table("worker", "is at", box=None, pad_edge=False)
        for where, shard in list(self._workers.items())[-_SHOWN_WORKERS:]:
            workers.add_row(where, shard)
        return Group(Columns([stages, workers], padding=(0, 4)), self._bars)


@dataclass
class _StageCount:
    """What became of the shards of one stage."""

    made: int = 0
    fresh: int = 0
    failed: int = 0
    seconds: float = 0.0


class Counter:
    """Counts things whose number is not known before: a live display on a terminal, nothing elsewhere."""

    def __init__(self, what: str) -> None:
        """Start with nothing done.

        Args:
            what: What is done, in words.
        """
        self._bars = bars.Progress(
            bars.TextColumn(f"{what}: {{task.completed:.0f}}"),
            console=Console(stderr=True),
            transient=True,
            disable=not sys.stderr.isatty(),
        )
        self._task = self._bars.add_task(what, total=None)

    def __enter__(self) -> Self:
        """Show the display."""
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the display away."""
        self._bars.stop()

    def tick(self) -> None:
        """Count one more."""
        self._bars.advance(self._task)


def status_table(statuses: Sequence[StageStatus]) -> Table:
    """Return the state of every stage as a table for the terminal."""
    table = Table(box=None, pad_edge=False)
    table.add_column("stage")
    for name in ("fresh", "stale", "missing", "rows", "MB", "seconds"):
        table.add_column(name, justify="right")
    table.add_column("why stale", overflow="fold")
    for item in statuses:
        table.add_row(
            item.stage, str(item.fresh), str(item.stale), str(item.missing), str(item.rows),
            f"{item.size_bytes / 1e6:.1f}", f"{item.seconds:.1f}", item.reason,
        )  # fmt: skip
    return table
