"""What a stage may open: what it declared in `reads`, and nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.stage import Stage
from upvl_cli.stages import BY_NAME
from upvl_cli.tables import Table

if TYPE_CHECKING:
    from upvl_cli.datasets.base import Drive
    from upvl_cli.kept_sweeps import Sweeps
    from upvl_cli.vlm.base import Model
    from upvl_cli.workspace import Workspace


class Inputs:
    """The declared inputs of one stage on one segment, and the count of what it kept and dropped."""

    def __init__(
        self,
        workspace: Workspace,
        stage: Stage,
        segment: str,
        settings: Any = None,
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        """Give a stage its inputs.

        Args:
            workspace: Where.
            stage: Which.
            segment: Of which drive.
            settings: The values it runs with; None takes those of its TOML file.
            tick: For a stage to tell that a part of a long row is done.
        """
        self._workspace = workspace
        self._stage = stage
        self._settings = settings
        self.tick = tick
        self.passing: list[Path] = []  # files that are of no use once the shard is made
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
        for segment in self.segments:
            try:
                yield self._workspace.drive(segment)
            except BadInput:
                self.count("drives that cannot be read", 1)

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the drives, for a stage that is made once for all of them.

        Raises:
            BadSetting: The stage's setting `drives` leaves none.
        """
        names = self._workspace.drives_of(self._stage, self._settings)
        if not names:
            asked = ", ".join(self._settings.drives) or "none"
            raise BadSetting(f"{self._stage.name}: no drive has a name like {asked}; see: upvl segments")
        return names

    def sweeps(self, segment: str) -> Sweeps:
        """The sweeps of a drive in any order, for a stage that reads each of them many times."""
        from upvl_cli.kept_sweeps import sweeps

        self._check("raw")
        return sweeps(self._workspace, segment, self.folder / "sweeps")

    @property
    def folder(self) -> Path:
        """Where the stage's shards are; what it needs to go on after a stop can stand beside them."""
        return self._workspace.out / self._stage.name

    @property
    def stamp(self) -> str:
        """What makes the shard that is being made."""
        return self._workspace.shard_stamp(self._stage, self.segment, self._settings)

    @property
    def model(self) -> Model:
        """The vision-language model."""
        self._check("vlm")
        return self._workspace.model

    def table(self, name: str, segment: str | None = None) -> Table:
        """The rows that another stage made of this segment, or of all drives.

        Args:
            name: The other stage.
            segment: The drive, for a stage that is made once for all of them.
        """
        self._check(name)
        source = name if segment is None else f"{name}/{segment}"
        path = dict(self._workspace.sources(self._stage, self.segment, self._settings))[source]
        return Table(path, BY_NAME[name].row)

    def count(self, reason: str, items: int) -> None:
        """Add to the number of items that were kept or dropped for that reason."""
        if items:
            self.counts[reason] += int(items)

    def _check(self, name: str) -> None:
        if name not in self._stage.reads:
            raise LookupError(f"stage {self._stage.name} opens {name!r}, which is not in its reads")
