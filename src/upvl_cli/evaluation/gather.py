"""Collects what is scored: the labels of all drives, and the boxes that a stage made of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.labels import LabelSource
from upvl_cli.errors import BadInput, NotMade
from upvl_cli.evaluation.detected_names import types_of
from upvl_cli.evaluation.region import Region
from upvl_cli.geometry.camera import project
from upvl_cli.metrics.inputs import Predictions, Truth, relabelled, resolved_level
from upvl_cli.pipeline.runner import state
from upvl_cli.pipeline.stage import Row
from upvl_cli.pipeline.tables import Table
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import ClassifyRow, ObjectRow, ScoredBoxRow
from upvl_cli.types import Array, Bools, Camera, Floats, Ints, Labels, ParallelArrays

# Whatever road user was labelled is an object, also of an unknown kind; a sign is none.
ANY_CLASS = {0: 1, 2: 1, 4: 1}

NAMES = "classify"  # the stage that gives labels their types
DETECTIONS = "detect"  # what it makes gets them by its own features

R = TypeVar("R", bound=Row)
Rows = TypeVar("Rows", bound=ParallelArrays)


@dataclass(frozen=True)
class Material:
    """Labels and predictions of all drives that have labels, where objects were labelled.

    Attributes:
        labels: All labels, with their level as stored: what tracking is scored against.
        points: (n,) LiDAR points inside each label, -1 where unknown.
        in_view: (n,) whether a camera sees the centre of each label.
        predictions: The boxes to score.
        has_class: Whether the boxes have a type; without it all of them are of type 0.
        segments: The drives.
        frames: How many frames of them are labelled.
        left_out: Why a drive could not be scored, by its name.
        dropped: How many labels and boxes are not counted, by reason.
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
        """The same, with every road user and every box of one type: an object."""
        labels, boxes = relabelled(self.labels, ANY_CLASS), relabelled(self.predictions, ANY_CLASS)
        return replace(self, labels=labels, predictions=boxes)

    def for_detection(self) -> tuple[Truth, Ints, Bools]:
        """Labels, their points and view, as the official detection tool takes them.

        Labels without any point are gone, and levels are resolved.
        """
        seen = self.points != 0
        points, labels = self.points[seen], self.labels[seen]
        # An unknown number of points says nothing of how hard a label is.
        level = np.where(points < 0, labels.level, resolved_level(labels.level, points))
        return replace(labels, level=level), points, self.in_view[seen]


@dataclass(frozen=True)
class _Drive:
    """What one drive adds."""

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
) -> Material:
    """The labels and the boxes of all drives of a workspace that have labels.

    Args:
        workspace: Where.
        stage: The stage that made the boxes.
        region: Boxes whose centre lies outside do not count, on either side; None takes all.
        named: Whether the boxes get types: those that the stage `name` found, or for detections its words.
        segments: Which drives; empty takes all.

    Raises:
        BadInput: No drive has labels, or a file of labels is damaged.
        NotMade: A drive has no such boxes, or they were made with other settings.
    """
    source, frames, left_out = labelled(workspace, segments)
    drives = {name: _of_drive(workspace, stage, source, name, frames[name], region, named) for name in frames}
    parts = list(drives.values())
    return Material(
        labels=_joined([part.labels for part in parts]),
        points=np.concatenate([part.points for part in parts]),
        in_view=np.concatenate([part.in_view for part in parts]),
        predictions=_joined([part.predictions for part in parts]),
        has_class=named,
        segments=tuple(drives),
        frames=sum(part.frames for part in parts),
        left_out=left_out,
        dropped=dict(sum((part.dropped for part in parts), Counter())),
    )


def labelled(
    workspace: Workspace, segments: Collection[str] = ()
) -> tuple[LabelSource, dict[str, Ints], dict[str, str]]:
    """The labels of a workspace, the labelled frames of each drive that has some, and why others have none.

    Args:
        workspace: Where.
        segments: Which drives; empty takes all.

    Raises:
        BadInput: No drive has labels.
    """
    source = label_source(workspace.raw.dataset, Path(workspace.raw.root), workspace.dataset)
    frames: dict[str, Ints] = {}
    left_out: dict[str, str] = {}
    for segment in segments or workspace.segments:
        try:
            frames[segment] = source.frames(segment)
        except BadInput as error:
            left_out[segment] = str(error)
    if not frames:
        others = f" (and so {len(left_out) - 1} more drives)" if len(left_out) > 1 else ""
        raise BadInput(next(iter(left_out.values())) + others)
    return source, frames, left_out


def checked_table(workspace: Workspace, stage: str, row: type[R], segment: str) -> Table[R]:
    """A shard that was made with the settings of today.

    Raises:
        NotMade: It is missing or stale.
    """
    condition, reason = state(workspace, workspace.pipeline.by_name[stage], segment)
    path = workspace.shard(stage, segment)
    if condition != "fresh":
        way = f"make {stage}" if stage == DETECTIONS else "upvl autolabel --all-motion, or --moving-only"
        raise NotMade(f"eval needs {path}, which is {condition} ({reason}); run: {way}")
    return Table(path, row)


def _of_drive(
    workspace: Workspace,
    stage: str,
    source: LabelSource,
    segment: str,
    frames: Ints,
    region: Region | None,
    named: bool,
) -> _Drive:
    rows = checked_table(workspace, stage, ScoredBoxRow, segment)
    chosen = [rows[frame] for frame in rows.frames if frame in frames]
    types = _types_of(workspace, stage, segment, rows, chosen, named)
    predictions = _predictions(segment, chosen, types)
    labels = source.labels(segment)
    truth = _truth(segment, labels)
    dropped: Counter[str] = Counter()
    kept = []
    for what, boxes in (("labels", truth), ("boxes", predictions)):
        covered = source.covers(segment, boxes.seven[:, :3])
        inside = region.holds(boxes.seven[:, :3]) if region else np.ones(len(boxes), dtype=np.bool_)
        dropped[f"{what} outside the labelled view"] += int((~covered).sum())
        dropped[f"{what} outside the region"] += int((covered & ~inside).sum())
        kept.append(covered & inside)
    truth, predictions = truth[kept[0]], predictions[kept[1]]
    view = _in_view(workspace.drive(segment).cameras, truth.seven[:, :3])
    return _Drive(truth, labels.num_points[kept[0]], view, predictions, len(frames), dropped)


def _truth(segment: str, labels: Labels) -> Truth:
    return Truth(
        sequence=np.full(len(labels), segment),
        frame=labels.frame,
        seven=labels.seven,
        type=labels.type,
        level=labels.difficulty,
        velocity_mps=labels.velocity_mps[:, :2],
        object_id=labels.object_id,
    )


def _types_of(
    workspace: Workspace,
    stage: str,
    segment: str,
    rows: Table[ScoredBoxRow],
    chosen: Sequence[Any],
    named: bool,
) -> list[Ints]:
    """(b,) the type of each box of each chosen row; 0 where none is asked for."""
    if not named:
        return [np.zeros(len(row.seven), np.int8) for row in chosen]
    if stage == DETECTIONS:
        of_frame = types_of(workspace, segment, workspace.table(DETECTIONS, ObjectRow, segment))
        return [of_frame[row.frame] for row in chosen]
    names = checked_table(workspace, NAMES, ClassifyRow, segment)
    return [_types(row, names[row.frame]) for row in chosen]


def _types(row: Any, names: Any) -> Ints:
    """(b,) the type of each box, by its track."""
    order = np.argsort(names.track_id)
    return np.asarray(names.type[order][np.searchsorted(names.track_id[order], row.track_id)])


def _predictions(segment: str, rows: Sequence[Any], types: Sequence[Ints]) -> Predictions:
    """The boxes of the labelled frames; of other frames nothing is known."""
    count = [len(row.seven) for row in rows]
    empty = np.zeros((0, 7))

    def column(name: str, like: Floats) -> Array:
        return np.concatenate([like, *(getattr(row, name) for row in rows)])

    return Predictions(
        sequence=np.full(sum(count), segment),
        frame=np.repeat([row.frame for row in rows], count),
        seven=column("seven", empty),
        type=np.concatenate([empty[:, 0], *types]),
        score=column("score", empty[:, 0]),
        velocity_mps=column("velocity_mps", empty[:, :3])[:, :2],
        object_id=column("track_id", empty[:, 0]).astype(np.int64),
        unlabelled=np.zeros(sum(count)),
    )


def _in_view(cameras: Sequence[Camera], xyz_ego_m: Array) -> Bools:
    seen = np.zeros(len(xyz_ego_m), dtype=np.bool_)
    for camera in cameras:
        seen |= project(camera, xyz_ego_m)[2]
    return seen


def _joined(parts: Sequence[Rows]) -> Rows:
    """The rows of all parts, one after the other."""
    first = parts[0]
    names = [spec.name for spec in fields(first)]
    return type(first)(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
