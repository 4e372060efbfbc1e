"""The drives of a workspace with their labels or detections, as formats take them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace

import numpy as np

from upvl_cli.errors import BadSetting, NotMade, UpvlError
from upvl_cli.export.corrections import corrected, corrections_path, read_corrections, same_boxes
from upvl_cli.export.drive import ExportBoxes, ExportDrive, Losses
from upvl_cli.export.point_tables import PointTables
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.correction_rows import DELETED
from upvl_cli.stages.rows import LabelRow, OdometryRow, ScoredBoxRow
from upvl_cli.types import Array, Bools, Drive, Frame, concat

STAGE_OF = {"labels": "labels", "corrected": "labels", "detections": "detect"}
HOW_TO_MAKE = {
    "labels": "upvl autolabel --all-motion",
    "corrected": "upvl autolabel --all-motion",
    "detections": "upvl train, then: upvl detect",
}

SelectBoxes = Callable[[ExportDrive], Bools]  # (n,) which boxes of a drive are taken


def labelled_segments(workspace: Workspace, what: str, segments: Collection[str]) -> list[str]:
    """Return the drives with boxes, or those that are named.

    Raises:
        BadSetting: There are no such boxes as `what`, or no such drive.
        NotMade: No drive has any.
    """
    if what not in STAGE_OF:
        raise BadSetting(f"--on {what}: expected {' or '.join(STAGE_OF)}")
    for segment in segments:
        workspace.check_name(segment, workspace.segments)
    made = [name for name in workspace.segments if workspace.shard(STAGE_OF[what], name).exists()]
    if not segments and not made:
        kind = "detections" if what == "detections" else "labels"
        raise NotMade(f"{workspace.out} has no {kind}; run: {HOW_TO_MAKE[what]}")
    return list(dict.fromkeys(segments)) or made


def drive_with_boxes(workspace: Workspace, segment: str, what: str, names: str) -> ExportDrive:
    """Return a drive and its boxes.

    Args:
        workspace: The workspace.
        segment: Name of the drive.
        what: A key of `STAGE_OF`; "corrected" is the labels with hand corrections over them, where there are any.
        names: "class" or "word": which column of labels names the boxes; a detection has neither.
    """
    drive = drive_geometry(workspace, segment)
    if what == "detections":
        detections = Table(workspace.shard("detect", segment), ScoredBoxRow)
        unnamed = [_boxes_of(row, np.full(len(row.track_id), "unknown")) for row in detections]
        return drive.with_boxes(concat(unnamed, ExportBoxes))
    rows = Table(workspace.shard("labels", segment), LabelRow)
    labels = concat([_boxes_of(row, _names_of(row, names)) for row in rows], ExportBoxes)
    if what == "labels" or not corrections_path(workspace, segment).is_file():
        return drive.with_boxes(labels)
    corrections = read_corrections(workspace, segment)
    boxes, _ = corrected(labels, corrections)
    deleted = labels[same_boxes(labels, corrections[corrections.change == DELETED])]
    return replace(drive, boxes=boxes, deleted=deleted)


def drive_geometry(workspace: Workspace, segment: str) -> ExportDrive:
    """Return a drive without boxes: its frames, poses and cameras."""
    poses = list(Table(workspace.shard("odometry", segment), OdometryRow))
    source = _source(workspace, segment)
    return ExportDrive(
        name=segment,
        frames=tuple(Frame(row.frame, row.time_ns) for row in poses),
        world_from_ego=np.array([row.world_from_ego for row in poses]).reshape(-1, 4, 4),
        cameras=source.cameras if source else (),
        boxes=concat([], ExportBoxes),
        source=source,
        point_columns=PointTables(workspace, segment),
    )


def selected(drives: Iterable[ExportDrive], select: SelectBoxes, losses: Losses) -> Iterator[ExportDrive]:
    """Yield each drive with the boxes that are taken, each with a track of its own where it has none."""
    for drive in drives:
        boxes = drive.boxes[select(drive)]
        alone = np.flatnonzero(boxes.track_id < 0)
        losses["boxes without a track: each is written as a track of its own"] += len(alone)
        ids = boxes.track_id.copy()
        ids[alone] = ids.max(initial=-1) + 1 + np.arange(len(alone))
        yield drive.with_boxes(replace(boxes, track_id=ids))


def _source(workspace: Workspace, segment: str) -> Drive | None:
    """Return the drive itself; None where its files are gone, as labels can be exported without them."""
    try:
        return workspace.drive(segment)
    except UpvlError:
        return None


def _names_of(row: LabelRow, names: str) -> Array:
    """Return (n,) the words, or the classes where a box has no word."""
    return np.where(row.word != "", row.word, row.class_name) if names == "word" else row.class_name


def _boxes_of(row: ScoredBoxRow, class_name: Array) -> ExportBoxes:
    boxes = row.tracked_boxes
    return ExportBoxes(
        boxes.center_m,
        boxes.size_lwh_m,
        boxes.heading_rad,
        boxes.velocity_mps,
        boxes.score,
        boxes.track_id,
        frame=np.full(len(boxes), row.frame),
        class_name=class_name,
        num_points=row.num_points,
    )
