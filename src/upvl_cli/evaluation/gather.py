"""Gathering of what is scored: the labels of all drives, and the boxes that a stage made of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.labels import LabelSource, UnlabelledZones
from upvl_cli.datasets.shared.tracks import velocities_of_tracks
from upvl_cli.errors import BadInput, NotMade
from upvl_cli.evaluation.corrected_labels import CorrectedLabels
from upvl_cli.evaluation.detection_types import detection_types
from upvl_cli.evaluation.region import Region
from upvl_cli.geometry.camera import project
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, map_types, resolve_level
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import Row
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import ClassifyRow, ObjectRow, OdometryRow, ScoredBoxRow
from upvl_cli.types import Array, Bools, Camera, Ints, Labels, TrackedBoxes, concat

# New type by type: every labelled road user is an object, also one of an unknown type; a sign is none.
CLASS_AGNOSTIC = {0: 1, 2: 1, 4: 1}

CLASSIFY = "classify"  # the stage that gives auto labels their types
ODOMETRY = "odometry"  # the stage that estimates poses where a drive has none
DETECT = "detect"  # the stage whose boxes get their types by their own features

R = TypeVar("R", bound=Row)


def _labels_of_dataset(workspace: Workspace) -> LabelSource:
    return label_source(workspace.raw.dataset, workspace.root, workspace.dataset)


HUMAN_LABELS, CORRECTIONS = "labels", "corrections"
# What boxes are scored against: the labels of the dataset, or the auto labels as a person has corrected them.
TRUTHS: dict[str, Callable[[Workspace], LabelSource]] = {
    HUMAN_LABELS: _labels_of_dataset,
    CORRECTIONS: CorrectedLabels,
}


@dataclass(frozen=True)
class Material:
    """Labels and predictions of all drives that have labels, where objects were labelled.

    Attributes:
        labels: All labels, with their level as stored: what tracking is scored against.
        points: (n,) LiDAR points inside each label, -1 where unknown.
        in_view: (n,) whether a camera sees the centre of each label.
        predictions: The boxes to score.
        has_class: Whether the boxes have a type; without one all of them are of type 0.
        segments: Names of the drives with labels.
        frames: Number of labelled frames.
        left_out: Reason why a drive could not be scored, by its name.
        dropped: Number of labels and boxes that do not count, by reason.
    """

    labels: Truth
    points: Ints
    in_view: Bools
    predictions: Predictions
    has_class: bool
    segments: tuple[str, ...]
    frames: int
    left_out: Mapping[str, str]
    dropped: Mapping[str, int]

    def without_classes(self) -> Material:
        """Return the same with one type, "object", for every road user and every box."""
        labels, boxes = map_types(self.labels, CLASS_AGNOSTIC), map_types(self.predictions, CLASS_AGNOSTIC)
        return replace(self, labels=labels, predictions=boxes)

    def for_detection(self) -> tuple[Truth, Ints, Bools]:
        """Return (labels, points, in_view) as the official detection tool takes them.

        Labels without a point are left out, and those without a level get one by their points.
        """
        has_points = self.points != 0
        points, labels = self.points[has_points], self.labels[has_points]
        # A label whose points nobody counted keeps its level: 0 counts at both.
        level = np.where(points < 0, labels.level, resolve_level(labels.level, points))
        return replace(labels, level=level), points, self.in_view[has_points]


@dataclass(frozen=True)
class _Drive:
    """Labels and predictions of one drive."""

    labels: Truth
    points: Ints
    in_view: Bools
    predictions: Predictions
    frames: int
    dropped: Counter[str]


def gather(
    workspace: Workspace,
    stage: str,
    *,
    region: Region | None,
    named: bool = False,
    segments: Collection[str] = (),
    truth: str = HUMAN_LABELS,
) -> Material:
    """Return the labels and the boxes of all drives of a workspace that have labels.

    Args:
        workspace: The workspace whose shards are scored.
        stage: The stage that made the boxes.
        region: Labels and boxes whose centre lies outside do not count; None takes all.
        named: Whether the boxes get types: those of the stage `classify`, or for detections those of its words.
        segments: Names of the drives; empty takes all.
        truth: A key of `TRUTHS`.

    Raises:
        BadInput: No drive has labels, or a file of labels is damaged.
        NotMade: A drive has no such boxes, or they were made with other settings.
    """
    source, frames, left_out = labelled_frames(workspace, segments, truth)
    drives = {
        name: _gather_drive(workspace, stage, source, name, frames[name], region, named) for name in frames
    }
    parts = list(drives.values())
    return Material(
        labels=concat([part.labels for part in parts], Truth),
        points=np.concatenate([part.points for part in parts]),
        in_view=np.concatenate([part.in_view for part in parts]),
        predictions=concat([part.predictions for part in parts], Predictions),
        has_class=named,
        segments=tuple(drives),
        frames=sum(part.frames for part in parts),
        left_out=left_out,
        dropped=dict(sum((part.dropped for part in parts), Counter())),
    )


def labelled_frames(
    workspace: Workspace, segments: Collection[str] = (), truth: str = HUMAN_LABELS
) -> tuple[LabelSource, dict[str, Ints], dict[str, str]]:
    """Return the source of labels, the labelled frames of each drive, and by drive the reason why it has none.

    Args:
        workspace: The workspace whose drives are looked at.
        segments: Names of the drives; empty takes all.
        truth: A key of `TRUTHS`.

    Raises:
        BadInput: No drive has labels.
    """
    source = TRUTHS[truth](workspace)
    frames: dict[str, Ints] = {}
    left_out: dict[str, str] = {}
    for segment in segments or workspace.segments:
        try:
            frames[segment] = source.frames(segment)
        except BadInput as error:
            left_out[segment] = str(error)
    if not frames:
        further = f" (and so {len(left_out) - 1} more drives)" if len(left_out) > 1 else ""
        raise BadInput(next(iter(left_out.values())) + further)
    return source, frames, left_out


def fresh_table(workspace: Workspace, stage: str, row: type[R], segment: str) -> Table[R]:
    """Return the rows of a shard that was made with the present settings.

    Args:
        workspace: The workspace of the shard.
        stage: The stage that makes it.
        row: The row that the stage declares.
        segment: Name of the drive.

    Raises:
        NotMade: It is missing or stale.
    """
    condition, reason = state(workspace, workspace.pipeline.by_name[stage], segment)
    path = workspace.shard(stage, segment)
    if condition != "fresh":
        command = f"make {stage}" if stage == DETECT else "upvl autolabel --all-motion, or --moving-only"
        raise NotMade(f"eval needs {path}, which is {condition} ({reason}); run: {command}")
    return Table(path, row)


def _gather_drive(
    workspace: Workspace,
    stage: str,
    source: LabelSource,
    segment: str,
    frames: Ints,
    region: Region | None,
    named: bool,
) -> _Drive:
    rows = fresh_table(workspace, stage, ScoredBoxRow, segment)
    chosen = [rows[frame] for frame in rows.frames if frame in frames]
    types = _box_types(workspace, stage, segment, rows, chosen, named)
    predictions = _predictions(source, segment, chosen, types)
    labels = with_velocities(workspace, segment, source.labels(segment))
    truth = _truth(segment, labels)
    dropped: Counter[str] = Counter()
    kept = []
    for what, boxes in (("labels", truth), ("boxes", predictions)):
        covered = source.covers(segment, boxes.center_m)
        inside = region.contains(boxes.center_m) if region else np.ones(len(boxes), dtype=np.bool_)
        dropped[f"{what} outside the labelled view"] += int((~covered).sum())
        dropped[f"{what} outside the region"] += int((covered & ~inside).sum())
        kept.append(covered & inside)
    truth, predictions = truth[kept[0]], predictions[kept[1]]
    view = _in_view(workspace.drive(segment).cameras, truth.center_m)
    return _Drive(truth, labels.num_points[kept[0]], view, predictions, len(frames), dropped)


def with_velocities(workspace: Workspace, segment: str, labels: Labels) -> Labels:
    """Return the labels with the velocities that the data set lacks, by the poses that were estimated.

    Args:
        workspace: The workspace of the drive.
        segment: Name of the drive.
        labels: Its labels.
    """
    unknown = np.isnan(labels.velocity_mps).any(axis=1, keepdims=True)
    drive = workspace.drive(segment)
    if not unknown.any() or drive.world_from_ego is not None:
        return labels
    poses = np.array([row.world_from_ego for row in fresh_table(workspace, ODOMETRY, OdometryRow, segment)])
    estimated = velocities_of_tracks(labels, drive.frames, poses)
    return replace(labels, velocity_mps=np.where(unknown, estimated, labels.velocity_mps))


def _truth(segment: str, labels: Labels) -> Truth:
    return Truth(
        center_m=labels.center_m,
        size_lwh_m=labels.size_lwh_m,
        heading_rad=labels.heading_rad,
        sequence=np.full(len(labels), segment),
        frame=labels.frame,
        type=labels.type,
        level=labels.difficulty,
        velocity_mps=labels.velocity_mps[:, :2],
        object_id=labels.object_id,
    )


def _box_types(
    workspace: Workspace,
    stage: str,
    segment: str,
    rows: Table[ScoredBoxRow],
    chosen: Sequence[ScoredBoxRow],
    named: bool,
) -> list[Ints]:
    """Return (b,) the type of each box of each chosen row; 0 where none is asked for."""
    if not named:
        return [np.zeros(len(row.track_id), np.int8) for row in chosen]
    if stage == DETECT:
        types = detection_types(workspace, segment, workspace.table(DETECT, ObjectRow, segment))
        return [types[row.frame] for row in chosen]
    classes = fresh_table(workspace, CLASSIFY, ClassifyRow, segment)
    return [_track_types(row, classes[row.frame]) for row in chosen]


def _track_types(row: ScoredBoxRow, classes: ClassifyRow) -> Ints:
    """Return (b,) the type of each box, joined by its track."""
    order = np.argsort(classes.track_id)
    return np.asarray(classes.type[order][np.searchsorted(classes.track_id[order], row.track_id)])


def _predictions(
    source: LabelSource, segment: str, rows: Sequence[ScoredBoxRow], types: Sequence[Ints]
) -> Predictions:
    """Return the boxes of the labelled frames; of other frames nothing is known."""
    count = [len(row.track_id) for row in rows]
    boxes = concat([row.tracked_boxes for row in rows], TrackedBoxes)
    return Predictions(
        center_m=boxes.center_m,
        size_lwh_m=boxes.size_lwh_m,
        heading_rad=boxes.heading_rad,
        sequence=np.full(sum(count), segment),
        frame=np.repeat([row.frame for row in rows], count),
        type=np.concatenate([np.zeros(0), *types]),
        score=boxes.score,
        velocity_mps=boxes.velocity_mps[:, :2],
        object_id=boxes.track_id,
        unlabelled=_unlabelled(source, segment, rows),
    )


def _unlabelled(source: LabelSource, segment: str, rows: Sequence[ScoredBoxRow]) -> Bools:
    """Return whether each box of the rows overlaps a zone without labels, where the data set tells these."""
    if not isinstance(source, UnlabelledZones):
        return np.zeros(sum(len(row.track_id) for row in rows), dtype=np.bool_)
    parts = [source.unlabelled(segment, row.frame, row.tracked_boxes) for row in rows]
    return np.concatenate([*parts, np.zeros(0, np.bool_)])


def _in_view(cameras: Sequence[Camera], xyz_ego_m: Array) -> Bools:
    """Return (n,) whether some camera's picture shows each place."""
    seen = np.zeros(len(xyz_ego_m), dtype=np.bool_)
    for camera in cameras:
        seen |= project(camera, xyz_ego_m)[2]
    return seen
