"""How large the shards of a stage will be, from a few frames of each drive."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from upvl_cli.config.base import Config
from upvl_cli.pipeline.inputs import ShardInputs
from upvl_cli.pipeline.pipeline import AnyStage
from upvl_cli.pipeline.stage import Row, Rows
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace

FRAMES = 6  # of each drive, evenly spread


R = TypeVar("R", bound=Row)


class _Few(Generic[R]):
    """A table of which only some frames are shown."""

    def __init__(self, table: Rows[R], frames: tuple[int, ...]) -> None:
        self._table, self.frames = table, frames

    def __iter__(self) -> Iterator[R]:
        return (self._table[frame] for frame in self.frames)

    def __getitem__(self, frame: int) -> R:
        return self._table[frame]

    def __len__(self) -> int:
        return len(self.frames)


class _FewFrames(ShardInputs):
    """The inputs of a stage, as if the drive had a few frames only."""

    def table(self, name: str, row: type[R], segment: str | None = None) -> Rows[R]:
        """The rows of the chosen frames."""
        table = super().table(name, row, segment)
        places = np.linspace(0, len(table) - 1, min(FRAMES, len(table))).round().astype(int)
        return _Few(table, tuple(table.frames[place] for place in places))


def estimate_size(workspace: Workspace, stage: AnyStage, segment: str, settings: Config) -> tuple[int, int]:
    """Bytes that a shard will have, and those that its drive's frames in it have on average.

    Args:
        workspace: Where.
        stage: Whose shard; it makes a row of each row of `odometry`.
        segment: Of which drive.
        settings: The values to make it with.
    """
    frames = len(workspace.drive(segment).frames)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "few.parquet")
        rows = write(
            path, stage.row, stage.run(_FewFrames(workspace, stage, segment), settings), stamp="{}", counts={}
        )
        each = path.stat().st_size // max(rows or 1, 1)
    return each * frames, each
