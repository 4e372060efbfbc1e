"""What a stage may open: what it declared in `reads`, and nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from upvl_cli.config.base import Config
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.stage import ALL_FRAMES, WHOLE_DATASET, FrameWindow, Row, Rows, Sweeps
from upvl_cli.pipeline.tables import Table

if TYPE_CHECKING:
    from upvl_cli.pipeline.storage.file_cache import FileCache
    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.types import Drive, Ints, Model

R = TypeVar("R", bound=Row)


class ShardInputs:
    """The declared inputs of one stage on one segment (an `Inputs`), and the count of what it kept and dropped."""

    def __init__(
        self,
        workspace: Workspace,
        stage: AnyStage,
        segment: str,
        settings: Config | None = None,
        tick: Callable[[], None] = lambda: None,
        window: FrameWindow = ALL_FRAMES,
    ) -> None:
        """Give a stage its inputs.

        Args:
            workspace: The workspace of the shard.
            stage: The stage that runs.
            segment: Name of the drive.
            settings: The values it runs with; None takes those of its TOML file.
            tick: Called when a part of a long row is done.
            window: The frames to yield rows of.
        """
        self._workspace = workspace
        self._stage = stage
        self._settings = settings
        self._tick = tick
        self.window = window
        self.temporary: list[Path] = []  # files that are of no use once the shard is made
        self.segment = segment
        self.counts: Counter[str] = Counter()

    @property
    def drive(self) -> Drive:
        """The drive itself."""
        self._check("raw")
        return self._workspace.drive(self.segment)

    def drives(self) -> Iterator[Drive]:
        """Yield all drives, for a stage that is made once for all of them; one that cannot be read is counted."""
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
            patterns: Any = getattr(self._settings, "drives", ())
            asked = ", ".join(patterns) or "none"
            raise BadSetting(f"{self._stage.name}: no drive has a name like {asked}; see: upvl segments")
        return names

    def lengths(self, name: str, segments: Sequence[str]) -> Ints:
        """Return (D,) how many frames the rows that another stage made of each of several drives have."""
        from upvl_cli.pipeline.lengths import lengths_of

        self._check(name)
        return lengths_of(self._workspace, name, segments)

    def sweeps(self, segment: str) -> Sweeps:
        """Return the sweeps of a drive in any order, for a stage that reads each of them many times."""
        from upvl_cli.pipeline.sweep_cache import CachedSweeps

        self._check("raw")
        workspace = self._workspace

        def open_drive() -> Drive:
            return workspace.pipeline.correct(workspace.dataset.open(segment), workspace.raw.corrections)

        return CachedSweeps(self._sweep_cache, segment, workspace.raw_stamp(segment), open_drive)

    @cached_property
    def _sweep_cache(self) -> FileCache:
        from upvl_cli.pipeline.sweep_cache import cache_beside

        return cache_beside(self.folder)

    @property
    def folder(self) -> Path:
        """Where the stage's shards are; what it needs to go on after a stop can stand beside them."""
        return self._workspace.out / self._stage.name

    @property
    def scratch(self) -> Path:
        """A local folder with room: that of the shards, or that of the copies of objects where those are remote."""
        from upvl_cli.pipeline.storage.file_cache import file_cache
        from upvl_cli.pipeline.storage.remote_path import is_remote

        return file_cache().parts if is_remote(self.folder) else self.folder

    @property
    def stamp(self) -> str:
        """What makes the shard that is being made."""
        return self._workspace.shard_stamp(self._stage, self.segment, self._settings)

    @property
    def model(self) -> Model:
        """The vision-language model."""
        self._check("vlm")
        return self._workspace.model

    def table(self, name: str, row: type[R], segment: str | None = None) -> Rows[R]:
        """Return the rows that another stage made of this segment, or of all drives.

        Args:
            name: The other stage.
            row: The row that it declares.
            segment: The drive, for a stage that is made once for all of them.
        """
        self._check(name)
        if not issubclass(self._workspace.pipeline.by_name[name].row, row):
            raise TypeError(f"stage {name} makes no rows of {row.__name__}")
        if segment is not None and segment not in self._chosen:
            raise LookupError(f"stage {self._stage.name} opens {segment!r}, which is not among its drives")
        is_of_dataset = self._workspace.pipeline.by_name[name].is_of_dataset
        path = self._workspace.shard(name, WHOLE_DATASET if is_of_dataset else segment or self.segment)
        return Table(path, row)

    @cached_property
    def _chosen(self) -> frozenset[str]:
        return frozenset(self.segments)

    def count(self, reason: str, items: int) -> None:
        """Add to the number of items that were kept or dropped for that reason."""
        if items:
            self.counts[reason] += int(items)

    def tick(self) -> None:
        """Say that a part of a long row is done."""
        self._tick()

    def discard_when_done(self, path: Path) -> None:
        """Name a file of `folder` that is of no use once the shard is made."""
        self.temporary.append(path)

    def _check(self, name: str) -> None:
        if name not in self._stage.reads:
            raise LookupError(f"stage {self._stage.name} opens {name!r}, which is not in its reads")
