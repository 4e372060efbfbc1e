"""What a stage may open: what it declared in `reads`, and nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from upvl_cli.errors import BadInput
from upvl_cli.stage import Stage
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Drive
    from upvl_cli.vlm.base import Model
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

    def drives(self) -> Iterator[Drive]:
        """All drives, for a stage that is made once for all of them; one that cannot be read is counted."""
        self._check("raw")
        for segment in self._workspace.segments:
            try:
                yield self._workspace.drive(segment)
            except BadInput:
                self.count("drives that cannot be read", 1)

    @property
    def model(self) -> Model:
        """The vision-language model."""
        self._check("vlm")
        return self._workspace.model

    def table(self, name: str) -> Table:
        """The rows that another stage made of this segment, or of all drives."""
        self._check(name)
        path = dict(self._workspace.sources(self._stage, self.segment))[name]
        return Table(path, BY_NAME[name].row)

    def count(self, reason: str, items: int) -> None:
        """Add to the number of items that were kept or dropped for that reason."""
        if items:
            self.counts[reason] += int(items)

    def _check(self, name: str) -> None:
        if name not in self._stage.reads:
            raise LookupError(f"stage {self._stage.name} opens {name!r}, which is not in its reads")
