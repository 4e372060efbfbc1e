"""Show how far a run is: a live display on a terminal, one line a shard elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from rich import progress as bars
from rich.console import Console
from rich.table import Table

from upvl_cli.commands.status import StageStatus
from upvl_cli.pipeline.runner import Made


class Progress:
    """Counts shards, and frames inside the one at hand, with rate and time left."""

    def __init__(self, shards: int) -> None:
        """Start with nothing done.

        Args:
            shards: How many shards the run will make or find fresh.
        """
        self._live = sys.stderr.isatty()
        self._frames = 0
        self._fresh = 0
        self._made = 0
        self._bars = bars.Progress(
            bars.TextColumn("{task.description}"),
            bars.BarColumn(),
            bars.MofNCompleteColumn(),
            bars.TextColumn("shards, {task.fields[frames]} frames, {task.fields[rate]:.1f} frames/s"),
            bars.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=not self._live,
        )
        self._task = self._bars.add_task("labelling", total=shards, frames=0, rate=0.0)

    def __enter__(self) -> Self:
        """Show the display."""
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the display away and say how it ended."""
        self._bars.stop()
        if self._live and kind is None:
            print(f"{self._made} shards made, {self._fresh} were fresh", file=sys.stderr)

    def tick(self) -> None:
        """Count one more frame."""
        self._frames += 1
        elapsed = self._bars.tasks[0].elapsed or 0.0
        self._bars.update(self._task, frames=self._frames, rate=self._frames / elapsed if elapsed else 0.0)

    def done(self, made: Made) -> None:
        """Count one more shard."""
        self._fresh += made.fresh
        self._made += not made.fresh
        self._bars.update(self._task, advance=1, description=f"{made.stage} {made.segment}")
        if not made.fresh and not self._live:
            print(
                f"made stage={made.stage} segment={made.segment} rows={made.rows} seconds={made.seconds:.2f}"
            )


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
