"""What is there of one drive: its sweeps, its pictures and its tables; what has not been made is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from upvl_cli.errors import BadInput, BadSetting, NotMade, UpvlError, one_line
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.perception.odometry.compensation import compensated_points
from upvl_cli.pipeline.stage import Row
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.picture_rows import SemanticsRow
from upvl_cli.stages.rows import FlowRow, GroundRow, LabelRow, MaskRow, OdometryRow
from upvl_cli.types import Array, Bools, Drive, Floats, Ints, Points

R = TypeVar("R", bound=Row)
T = TypeVar("T")
# What a table gives to the picture of a drive, for the message where it has not been made.
_GIVES = {
    "odometry": "poses",
    "ground": "heights and ground",
    "flow": "flow",
    "mask": "moving points and background",
    "labels": "boxes",
    "semantics": "classes of points",
}
NO_WORD = -1
_BOX_MARGIN_M = 0.1  # points on the faces of a box belong to it


@dataclass(frozen=True)
class FramePoints:
    """The n points of one sweep and what is known of each; None where that has not been made.

    Attributes:
        points: The sweep, in ego axes.
        flow_mps: (n, 3) velocity over the ground, along the ego axes.
        height_m: (n,) height above the ground below the point.
        is_ground: (n,) part of the ground.
        is_moving: (n,) at least as fast as the setting min_speed_mps of mask.
        background: (n,) 1 background, 0 not, -1 unknown.
        words: Names that word_index counts.
        word_index: (n,) place of the word of each point in `words`, NO_WORD for none.
    """

    points: Points
    flow_mps: Floats | None
    height_m: Floats | None
    is_ground: Bools | None
    is_moving: Bools | None
    background: Ints | None
    words: tuple[str, ...]
    word_index: Ints | None


class DriveTables:
    """One drive with the tables that were made of it."""

    def __init__(self, workspace: Workspace, segment: str) -> None:
        """Open a drive and its tables.

        Args:
            workspace: The workspace of the drive.
            segment: Name of the drive.

        Raises:
            BadSetting: There is no such drive.
            BadInput: The drive cannot be read, and it has neither labels nor poses.
        """
        self._workspace = workspace
        self.segment = segment
        self.missing: list[str] = []
        self._odometry = self._open("odometry", OdometryRow)
        self._ground = self._open("ground", GroundRow)
        self._flow = self._open("flow", FlowRow)
        self._mask = self._open("mask", MaskRow)
        self._labels = self._open("labels", LabelRow)
        self._semantics = self._open("semantics", SemanticsRow)
        self.drive = self._open_drive()
        self._frames = {name: frozenset(table.frames) for name, table in self._tables.items()}

    def _open(self, stage: str, row: type[R]) -> Table[R] | None:
        try:
            return self._workspace.table(stage, row, self.segment)
        except NotMade as error:
            path = self._workspace.shard(stage, self.segment)
            why = one_line(error) if path.exists() else f"upvl {stage} has not been run"
            self.missing.append(f"no {_GIVES[stage]} ({why})")
            return None

    def _open_drive(self) -> Drive | None:
        try:
            return self._workspace.drive(self.segment)
        except UpvlError as error:
            if self._labels is None and self._odometry is None:
                raise
            self.missing.insert(0, f"no points and no pictures ({one_line(error)})")
            return None

    @property
    def _tables(self) -> dict[str, Table[Row]]:
        tables = {
            "odometry": self._odometry,
            "ground": self._ground,
            "flow": self._flow,
            "mask": self._mask,
            "labels": self._labels,
            "semantics": self._semantics,
        }
        return {name: table for name, table in tables.items() if table is not None}  # type: ignore[misc]

    @cached_property
    def times_ns(self) -> dict[int, int]:
        """Time of each frame by its number, ascending."""
        if self.drive is not None:
            return {frame.index: frame.time_ns for frame in self.drive.frames}
        rows = self._odometry or self._labels or ()
        return {row.frame: row.time_ns for row in rows}

    @cached_property
    def world_from_ego(self) -> dict[int, Array]:
        """(4, 4) pose of each frame by its number: those of odometry, else those of the drive itself."""
        if self._odometry is not None:
            return {row.frame: row.world_from_ego for row in self._odometry}
        given = None if self.drive is None else self.drive.world_from_ego
        return {} if given is None else dict(zip(self.times_ns, given, strict=True))

    @property
    def has(self) -> frozenset[str]:
        """Names of the stages whose tables are there."""
        return frozenset(self._tables)

    def labels(self, frame: int) -> LabelRow | None:
        """Return the labels of a frame; None where there are none."""
        return self._row("labels", self._labels, frame)

    def points(self, frame: int) -> FramePoints | None:
        """Return the points of a frame with what was made of them; None where the drive cannot be read.

        Args:
            frame: Number of the frame.
        """
        if self.drive is None:
            return None
        points = self._sweep(frame)
        total = len(points)
        ground, flow = self._row("ground", self._ground, frame), self._row("flow", self._flow, frame)
        mask = self._row("mask", self._mask, frame)
        words, word_index = self._words(points, frame)
        return FramePoints(
            points,
            _values(flow, "flow_mps", total),
            _values(ground, "height_m", total),
            _values(ground, "is_ground", total),
            _values(mask, "is_moving", total),
            _values(mask, "background", total),
            words,
            word_index,
        )

    @cached_property
    def _sweep(self) -> Callable[[int], Points]:
        assert self.drive is not None
        if self._odometry is None:
            return self.drive.points
        return compensated_points(self.drive, self._odometry)

    def _row(self, stage: str, table: Table[R] | None, frame: int) -> R | None:
        return table[frame] if table is not None and frame in self._frames[stage] else None

    def _words(self, points: Points, frame: int) -> tuple[tuple[str, ...], Ints | None]:
        """Return the classes of all points where they were made, else the words of the boxes that hold points."""
        semantics = self._row("semantics", self._semantics, frame)
        index = _values(semantics, "class_index", len(points))
        if semantics is not None and index is not None:
            return tuple(semantics.class_name.tolist()), index.astype(np.int64)
        labels = self.labels(frame)
        if labels is None:
            return (), None
        names, word = np.unique(labels.word.astype(str), return_inverse=True)
        index = np.full(len(points), NO_WORD)
        box, point = pairs_inside(points.xyz_ego_m, labels.boxes, margin_m=_BOX_MARGIN_M)
        weak_first = np.argsort(labels.score[box], kind="stable")
        index[point[weak_first]] = word.reshape(-1)[box[weak_first]]
        if "" in names:  # tracks that no camera saw
            index[index == names.tolist().index("")] = NO_WORD
        return tuple(names.tolist()), index


def chosen_frames(tables: DriveTables, frame_range: tuple[int, int] | None) -> list[int]:
    """Return the numbers of the frames to show.

    Args:
        tables: The drive.
        frame_range: First and last frame; None takes all.

    Raises:
        BadSetting: No frame of the drive lies in the range.
        BadInput: The drive has no frame.
    """
    frames = list(tables.times_ns)
    if not frames:
        raise BadInput(f"{tables.segment} has no frame: nothing can be shown of it; see: upvl check")
    first, last = frame_range or (frames[0], frames[-1])
    chosen = [frame for frame in frames if first <= frame <= last]
    if not chosen:
        raise BadSetting(
            f"{tables.segment} has no frame from {first} to {last}: it has {frames[0]} to {frames[-1]}"
        )
    return chosen


def _values(row: Row | None, column: str, total: int) -> Array | None:
    """Return a column of all points; None where the table was made of other sweeps, of another number of points."""
    values: Array | None = None if row is None else getattr(row, column)
    return values if values is not None and len(values) == total else None
