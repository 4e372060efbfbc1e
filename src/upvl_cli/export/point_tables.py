"""What the tables of a workspace say of single points: their height, flow, motion and word."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import SemanticsRow
from upvl_cli.stages.rows import FlowRow, GroundRow, MaskRow
from upvl_cli.types import Array

# The columns of points by the stage that makes them, as their tables name them.
COLUMNS_OF = {
    "ground": ("height_m", "is_ground"),
    "flow": ("flow_mps",),
    "mask": ("is_moving",),
    "semantics": ("class_index", "class_name"),
}
_ROWS: Mapping[str, Any] = {"ground": GroundRow, "flow": FlowRow, "mask": MaskRow, "semantics": SemanticsRow}


class PointTables:
    """The tables of points of one drive that exist; each is opened when the first frame is asked for."""

    def __init__(self, workspace: Workspace, segment: str) -> None:
        """Note which there are.

        Args:
            workspace: The workspace.
            segment: Name of the drive.
        """
        paths = {stage: workspace.shard(stage, segment) for stage in _ROWS}
        self._paths = {stage: path for stage, path in paths.items() if path.exists()}
        self._tables: dict[str, Table[Any]] = {}

    def __call__(self, frame: int) -> dict[str, Array]:
        """Return columns of `COLUMNS_OF` for the points of a frame, those that are made.

        Raises:
            NotMade: A table is damaged.
        """
        columns: dict[str, Array] = {}
        for stage, path in self._paths.items():
            if stage not in self._tables:
                self._tables[stage] = Table(path, _ROWS[stage])
            table = self._tables[stage]
            if frame in table.frames:
                row = table[frame]
                columns |= {name: getattr(row, name) for name in COLUMNS_OF[stage]}
        return columns
