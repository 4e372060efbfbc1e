"""The auto labels of one drive and its tracks, in arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import LabelRow
from upvl_cli.types import Array, Bools, Ints, TrackedBoxes


@dataclass(frozen=True)
class DriveLabels:
    """The auto labels of one drive.

    Attributes:
        segment: Name of the drive.
        frames: Its T frames, ascending.
        time_ns: (T,) time of each frame.
        place: (n,) place of the frame of each box among `frames`, ascending.
        boxes: The n boxes, each in the ego axes of its frame.
        class_name: (n,) class of each box.
        word: (n,) word of each box; empty where no camera saw it.
        is_moving: (n,) whether it moves in its frame.
    """

    segment: str
    frames: tuple[int, ...]
    time_ns: Ints
    place: Ints
    boxes: TrackedBoxes
    class_name: Array
    word: Array
    is_moving: Bools

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last."""
        return float(self.time_ns[-1] - self.time_ns[0]) * 1e-9 if len(self.time_ns) else 0.0

    @property
    def speed_mps(self) -> Array:
        """(n,) horizontal speed of each box over the ground."""
        return np.asarray(np.linalg.norm(self.boxes.velocity_mps[:, :2], axis=1))

    @property
    def range_m(self) -> Array:
        """(n,) horizontal distance of each box from the car."""
        return np.asarray(np.linalg.norm(self.boxes.center_m[:, :2], axis=1))

    def at(self, place: int) -> Ints:
        """Return the places of the boxes of one frame, given the place of the frame."""
        first, end = np.searchsorted(self.place, [place, place + 1])
        return np.arange(first, end)


@dataclass(frozen=True)
class TrackTable:
    """The tracks of one drive or of several.

    Attributes:
        track_id: (k,) number of each track in its drive.
        class_name: (k,) its class.
        word: (k,) its word; empty where no camera saw it.
        num_boxes: (k,) number of its boxes.
        duration_s: (k,) time from its first box to its last.
        is_moving: (k,) whether it moves in one frame at least.
        size_lwh_m: (k, 3) its median size.
        score: (k,) its highest score.
        top_speed_mps: (k,) its highest speed.
    """

    track_id: Ints
    class_name: Array
    word: Array
    num_boxes: Ints
    duration_s: Array
    is_moving: Bools
    size_lwh_m: Array
    score: Array
    top_speed_mps: Array

    def __len__(self) -> int:
        return len(self.track_id)


def read_labels(workspace: Workspace, segment: str) -> DriveLabels:
    """Return the auto labels of a drive.

    Raises:
        NotMade: They are missing or damaged.
    """
    table = workspace.table("labels", LabelRow, segment)
    rows = list(table)

    def column(name: str, kind: str, width: int = 0) -> Any:
        shape = (0, width) if width else (0,)
        return np.concatenate([np.zeros(shape, kind), *(np.asarray(getattr(row, name)) for row in rows)])

    boxes = TrackedBoxes(
        column("center_m", "float64", 3),
        column("size_lwh_m", "float64", 3),
        column("heading_rad", "float64"),
        column("velocity_mps", "float64", 3),
        column("score", "float64"),
        column("track_id", "int64"),
    )
    return DriveLabels(
        segment=segment,
        frames=table.frames,
        time_ns=np.array([row.time_ns for row in rows], dtype=np.int64),
        place=np.repeat(np.arange(len(rows)), [len(row.track_id) for row in rows]),
        boxes=boxes,
        class_name=column("class_name", "str"),
        word=column("word", "str"),
        is_moving=column("is_moving", "bool"),
    )


def tracks_of(labels: DriveLabels) -> TrackTable:
    """Return the tracks of a drive, in the order of their numbers."""
    ids, first, track = np.unique(labels.boxes.track_id, return_index=True, return_inverse=True)
    order = np.argsort(track, kind="stable")
    num_boxes = np.bincount(track, minlength=len(ids))
    groups = np.split(order, np.cumsum(num_boxes)[:-1]) if len(ids) else []
    time_ns, speed_mps = labels.time_ns[labels.place], labels.speed_mps
    sizes = [np.median(labels.boxes.size_lwh_m[group], axis=0) for group in groups]
    return TrackTable(
        track_id=ids,
        class_name=labels.class_name[first],
        word=labels.word[first],
        num_boxes=num_boxes,
        duration_s=np.array([np.ptp(time_ns[group]) * 1e-9 for group in groups]),
        is_moving=np.bincount(track, labels.is_moving, minlength=len(ids)) > 0,
        size_lwh_m=np.array(sizes).reshape(-1, 3),
        score=np.array([labels.boxes.score[group].max() for group in groups]),
        top_speed_mps=np.array([speed_mps[group].max() for group in groups]),
    )


def concat_tracks(tables: Sequence[TrackTable]) -> TrackTable:
    """Return the tracks of several drives in one table; their numbers repeat."""
    return TrackTable(
        **{
            name: np.concatenate([getattr(table, name) for table in tables])
            for name in TrackTable.__dataclass_fields__
        }
    )
