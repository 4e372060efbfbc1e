"""What a stage may open: what it declared in `reads`, and nothing else."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from upvl_cli.stage import Stage
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Drive
    from upvl_cli.workspace import Workspace


class Inputs:
    """The declared inputs of one stage on one segment, and the count of what it kept and dropped."""

    def __init__(self, workspace: Workspace, stage: Stage, segment: str) -> None:
        """Give a stage its inputs."""
        self._workspace = workspace
        self._stage = stage
        self.segment = segment
        self.counts: Counter[str] = Counter()

    @property
    def drive(self) -> Drive:
        """The drive itself."""
        self._check("raw")
        return self._workspace.drive(self.segment)

    def table(self, name: str) -> Table:
        """The rows that another stage made of this segment."""
        self._check(name)
        return Table(self._workspace.shard(name, self.segment), BY_NAME[name].row)

    def count(self, reason: str, items: int) -> None:
        """Add to the number of items that were kept or dropped for that reason."""
        if items:
            self.counts[reason] += int(items)

    def _check(self, name: str) -> None:
        if name not in self._stage.reads:
            raise LookupError(f"stage {self._stage.name} opens {name!r}, which is not in its reads")
