"""A drive as formats take it: frames, poses, cameras, and its labelled boxes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.datasets.shared.class_types import type_of_class
from upvl_cli.errors import BadInput
from upvl_cli.geometry.se3 import rotate
from upvl_cli.types import Array, Camera, Drive, Frame, Ints, Labels, TrackedBoxes, array

Losses = Counter[str]  # what a format cannot carry, by reason: told to the user, and kept in the manifest


@dataclass(frozen=True)
class ExportBoxes(TrackedBoxes):
    """The boxes of a whole drive, by frame, each in the ego axes of its frame.

    Attributes:
        frame: (n,) index of the frame.
        class_name: (n,) name of the class, in the words of upvl or of the format.
        num_points: (n,) LiDAR points of the box, -1 where unknown.
    """

    frame: Array = array("int64")
    class_name: Array = array("str")
    num_points: Array = array("int64")


@dataclass(frozen=True)
class ExportDrive:
    """One drive with its boxes.

    Attributes:
        name: Name of the segment.
        frames: The T frames, ascending.
        world_from_ego: (T, 4, 4) pose of each.
        cameras: Its calibrated cameras.
        boxes: The boxes, by ascending frame.
        source: Gives points and pictures; None where the drive cannot be read.
        deleted: Labels that a person has deleted: who edits an export of corrected labels knows of them.
        point_columns: Gives what is known of the points of a frame, by the names of `point_tables`; None where
            nothing is.
    """

    name: str
    frames: tuple[Frame, ...]
    world_from_ego: Array
    cameras: tuple[Camera, ...]
    boxes: ExportBoxes
    source: Drive | None = None
    deleted: ExportBoxes | None = None
    point_columns: Callable[[int], Mapping[str, Array]] | None = None

    @property
    def places(self) -> Ints:
        """(n,) position of each box's frame among the frames."""
        return self.places_of(self.boxes.frame)

    @property
    def times_ns(self) -> Ints:
        """(T,) time of each frame."""
        return np.array([frame.time_ns for frame in self.frames], dtype=np.int64)

    def places_of(self, frames: Sequence[int] | Ints) -> Ints:
        """Return (k,) the positions of frames with these indices.

        Raises:
            BadInput: The drive has no such frame.
        """
        known = np.array([frame.index for frame in self.frames], dtype=np.int64)
        wanted = np.asarray(frames, dtype=np.int64)
        places = np.searchsorted(known, wanted).clip(max=max(len(known) - 1, 0))
        missing = wanted if not len(known) else wanted[known[places] != wanted]
        if len(missing):
            raise BadInput(f"drive {self.name} has no frame {missing[0]}; expected {self._span()}")
        return places

    def frames_at(self, times_ns: Sequence[int] | Ints, tolerance_ns: int) -> Ints:
        """Return (k,) the index of the frame that is nearest to each time.

        Raises:
            BadInput: No frame is as near as the tolerance.
        """
        times, wanted = self.times_ns, np.asarray(times_ns, dtype=np.int64)
        if not len(times) and len(wanted):
            raise BadInput(f"drive {self.name} has no frame at all")
        after = np.searchsorted(times, wanted).clip(max=max(len(times) - 1, 0))
        before = (after - 1).clip(min=0)
        nearer = np.abs(times[before] - wanted) < np.abs(times[after] - wanted)
        places = np.where(nearer, before, after) if len(wanted) else np.zeros(0, np.int64)
        off = np.abs(times[places] - wanted) > tolerance_ns if len(wanted) else np.zeros(0, np.bool_)
        if off.any():
            raise BadInput(
                f"drive {self.name} has no frame at {wanted[off][0]} ns; expected {times[0]} to {times[-1]} ns"
            )
        return np.array([self.frames[place].index for place in places], dtype=np.int64)

    def velocity_world_mps(self) -> Array:
        """Return (n, 3) the velocity of each box along the world's axes."""
        return rotate(self.world_from_ego[self.places], self.boxes.velocity_mps[:, None])[:, 0]

    def with_boxes(self, boxes: ExportBoxes) -> ExportDrive:
        """Return the drive with other boxes, by ascending frame."""
        order = np.argsort(boxes.frame, kind="stable")
        return replace(self, boxes=boxes[order])

    def _span(self) -> str:
        return f"{self.frames[0].index} to {self.frames[-1].index}" if self.frames else "no frame at all"


def labels_of(boxes: ExportBoxes) -> Labels:
    """Return boxes as labels; their points are not counted, and nothing says how difficult they are."""
    return Labels(
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        frame=boxes.frame,
        object_id=boxes.track_id.astype(str),
        class_name=boxes.class_name,
        type=np.array([type_of_class(str(name)) for name in boxes.class_name], dtype=np.int8),
        velocity_mps=boxes.velocity_mps,
        num_points=np.full(len(boxes), -1),
        difficulty=np.zeros(len(boxes)),
    )


def track_numbers(ids: Sequence[str]) -> Ints:
    """Return (n,) a number for each id: its own, or a new one above all others where the id is no number."""
    known = {text: int(text) for text in ids if text.isascii() and text.isdigit() and len(text) < 18}
    following = max(known.values(), default=-1) + 1
    for text in ids:
        if text not in known:
            known[text], following = following, following + 1
    return np.array([known[text] for text in ids], dtype=np.int64)


def boxes_of_rows(rows: Sequence[Array] | Array, **others: Sequence[object] | Array) -> ExportBoxes:
    """Return boxes from rows of x, y, z, length, width, height (m), heading (rad), in ego axes.

    Args:
        rows: (n, 7) boxes.
        others: frame, track_id, class_name; score (1 where left out), velocity_mps (NaN), num_points (-1).
    """
    n = len(rows)
    given: dict[str, Array] = {
        "score": np.ones(n),
        "velocity_mps": np.full((n, 3), np.nan),
        "num_points": np.full(n, -1),
    } | {name: np.asarray(values) for name, values in others.items()}
    return ExportBoxes.from_rows(np.asarray(rows, dtype=np.float64).reshape(n, 7), **given)
