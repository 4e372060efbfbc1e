"""What changed between two runs over the same drives: boxes, tracks, settings and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from upvl_cli.drawing.birds_eye import BoxPaint
from upvl_cli.drawing.colours import CHANGES
from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.geometry.boxes import geometry_of
from upvl_cli.geometry.iou import iou_3d
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.report.drive_labels import DriveLabels, read_labels
from upvl_cli.types import Array, Ints, TrackedBoxes

# The 3D IoU that benchmarks of vehicles ask for: below it a box stands elsewhere or has another size.
KEPT_IOU = 0.7
# Small boxes that moved by their own width overlap no more, and are matched by their centres.
NEAR_M = 1.0


@dataclass(frozen=True)
class BoxChanges:
    """How many boxes became what between two runs.

    Attributes:
        kept: Matched with a 3D IoU of `KEPT_IOU` or more.
        moved: Matched with a lower one.
        new: Boxes of this run without a match.
        lost: Boxes of the other run without a match.
        renamed: Of those matched, with another class.
    """

    kept: int = 0
    moved: int = 0
    new: int = 0
    lost: int = 0
    renamed: int = 0

    def __add__(self, other: BoxChanges) -> BoxChanges:
        return BoxChanges(
            self.kept + other.kept,
            self.moved + other.moved,
            self.new + other.new,
            self.lost + other.lost,
            self.renamed + other.renamed,
        )

    @property
    def total(self) -> int:
        """Boxes that are not as they were."""
        return self.moved + self.new + self.lost + self.renamed


@dataclass(frozen=True)
class BoxMatch:
    """One-to-one matches between the boxes of two runs in one frame.

    Attributes:
        before: (k,) places of matched boxes of the other run.
        after: (k,) places of their matches in this run.
        iou: (k,) their 3D IoU.
    """

    before: Ints
    after: Ints
    iou: Array


@dataclass(frozen=True)
class DriveChange:
    """What changed in one drive.

    Attributes:
        segment: Name of the drive.
        changes: Its boxes, over the frames that both runs have.
        frames: Number of those frames.
        frames_of_one: Number of frames that only one of the runs has.
        worst_place: Place in this run of the frame that changed most; -1 without a common frame.
        worst: What changed in that frame.
    """

    segment: str
    changes: BoxChanges
    frames: int
    frames_of_one: int
    worst_place: int
    worst: BoxChanges


def other_run(workspace: Workspace, out: Path, segments: Sequence[str]) -> tuple[Workspace, list[str]]:
    """Return the workspace of another run's results, and the drives that both have labelled.

    Raises:
        BadSetting: The folder is missing, or has labels of none of the drives.
    """
    if not out.is_dir():
        raise BadSetting(
            f"--against {out}: no such folder; name the folder of another run's results, such as out2"
        )
    other = Workspace(workspace.pipeline, workspace.stages, out)
    common = [segment for segment in segments if other.shard("labels", segment).exists()]
    if not common:
        raise BadSetting(
            f"--against {out}: it holds labels of none of the drives ({', '.join(list(segments)[:3])}"
            f"{', ...' if len(segments) > 3 else ''}); label them there first: upvl --out {out} autolabel"
        )
    return other, common


def compare_drive(before: DriveLabels, after: DriveLabels) -> DriveChange:
    """Return what changed between two runs over a drive.

    Args:
        before: Labels of the other run.
        after: Labels of this run.
    """
    place_before = {frame: place for place, frame in enumerate(before.frames)}
    total, worst, worst_place, frames = BoxChanges(), BoxChanges(), -1, 0
    for place, frame in enumerate(after.frames):
        if frame not in place_before:
            continue
        frames += 1
        changes = frame_changes(before, place_before[frame], after, place)
        total += changes
        if worst_place < 0 or changes.total > worst.total:
            worst, worst_place = changes, place
    of_one = len(before.frames) + len(after.frames) - 2 * frames
    return DriveChange(after.segment, total, frames, of_one, worst_place, worst)


def frame_changes(before: DriveLabels, place_before: int, after: DriveLabels, place_after: int) -> BoxChanges:
    """Return what changed in one frame, given its place in both runs."""
    old, new = before.at(place_before), after.at(place_after)
    match = match_boxes(before.boxes[old], after.boxes[new])
    kept = int((match.iou >= KEPT_IOU).sum())
    renamed = before.class_name[old[match.before]] != after.class_name[new[match.after]]
    return BoxChanges(
        kept=kept,
        moved=len(match.iou) - kept,
        new=len(new) - len(match.iou),
        lost=len(old) - len(match.iou),
        renamed=int(renamed.sum()),
    )


def match_boxes(before: TrackedBoxes, after: TrackedBoxes) -> BoxMatch:
    """Return the matches of largest total 3D IoU; boxes that do not overlap match where their centres are near."""
    if not len(before) or not len(after):
        return BoxMatch(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    iou = np.asarray(iou_3d(geometry_of(before), geometry_of(after)))
    apart_m = np.linalg.norm(before.center_m[:, None, :2] - after.center_m[None, :, :2], axis=2)
    # Below any overlap that matters, so that nearness decides only where nothing overlaps.
    worth = iou + 0.01 * np.maximum(1 - apart_m / NEAR_M, 0)
    rows, columns = linear_sum_assignment(worth, maximize=True)
    matched = worth[rows, columns] > 0
    rows, columns = rows[matched], columns[matched]
    return BoxMatch(rows, columns, iou[rows, columns])


def change_paints(
    before: DriveLabels, after: DriveLabels, place_after: int
) -> tuple[TrackedBoxes, list[BoxPaint]]:
    """Return the boxes of both runs in one frame with the colours of what became of them; the lost are drawn first."""
    place_before = before.frames.index(after.frames[place_after])
    old, new = before.boxes[before.at(place_before)], after.boxes[after.at(place_after)]
    match = match_boxes(old, new)
    state = np.full(len(new), "new", dtype=object)
    state[match.after] = np.where(match.iou >= KEPT_IOU, "kept", "moved")
    lost = np.setdiff1d(np.arange(len(old)), match.before)
    moved_from = match.before[match.iou < KEPT_IOU]
    first = np.concatenate([moved_from, lost])
    paints = [BoxPaint(CHANGES["kept"], "")] * len(moved_from)
    paints += [BoxPaint(CHANGES["lost"], str(track_id)) for track_id in old.track_id[lost].tolist()]
    paints += [
        BoxPaint(CHANGES[name], "" if name == "kept" else str(track_id))
        for name, track_id in zip(state, new.track_id.tolist(), strict=True)
    ]
    return _concat(old[first], new), paints


def _concat(first: TrackedBoxes, second: TrackedBoxes) -> TrackedBoxes:
    names = TrackedBoxes.__dataclass_fields__
    return TrackedBoxes(
        **{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in names}
    )


def read_both(other: Workspace, after: DriveLabels) -> DriveLabels | None:
    """Return the labels of the other run over a drive, or None where they are damaged."""
    try:
        return read_labels(other, after.segment)
    except NotMade:
        return None
