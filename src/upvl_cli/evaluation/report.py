"""The report of an evaluation, as lines and tables for the terminal and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.table import Table

from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.flow_score import FlowScore
from upvl_cli.evaluation.region import Region
from upvl_cli.evaluation.score import DetectionScore, Diagnosis, TrackScore
from upvl_cli.metrics.flow_objects import ObjectFlowScore


@dataclass(frozen=True)
class Scope:
    """What a report is about.

    Attributes:
        what: "labels", "detections" or "tracks".
        mode: "moving-only" or "all-motion".
        region: The part of the ground that counts; None for all of it.
        settings: The settings of `eval`.
        segments: Names of the drives.
        frames: Number of labelled frames.
        labels: Number of labels, moving and standing.
        without_velocity: Number of labels without a velocity, which count as standing.
        boxes: Number of boxes.
        left_out: Reason why a drive could not be scored, by its name.
        dropped: Number of labels and boxes that do not count, by reason.
        truth: What the boxes are scored against: "labels" or "corrections".
    """

    what: str
    mode: str
    region: Region | None
    settings: EvalConfig
    segments: tuple[str, ...]
    frames: int
    labels: int
    without_velocity: int
    boxes: int
    left_out: Mapping[str, str]
    dropped: Mapping[str, int]
    truth: str = "labels"


@dataclass(frozen=True)
class NamedScore:
    """Average precision (level 2) by class at one IoU.

    Attributes:
        iou: Minimum 3D IoU of a match.
        vehicle: Average precision of vehicles.
        vru: Average precision of pedestrians and cyclists as one class.
        mean: Mean of both.
    """

    iou: float
    vehicle: float
    vru: float
    mean: float


@dataclass(frozen=True)
class Report:
    """One evaluation.

    Attributes:
        scope: What was scored.
        detection: Class-agnostic average precision; empty for tracks.
        named: Average precision by class; empty where it was not asked for.
        diagnosis: Analysis of the errors; None for tracks.
        tracking: CLEAR-MOT scores; empty for labels and detections.
        flow: Errors of the flow; None but for labels of a dataset that knows the true flow.
    """

    scope: Scope
    detection: Sequence[DetectionScore] = ()
    named: Sequence[NamedScore] = ()
    diagnosis: Diagnosis | None = None
    tracking: Sequence[TrackScore] = ()
    flow: FlowScore | None = None

    @property
    def name(self) -> str:
        """Name of the files that it is written to, without suffix."""
        against = f"-against-{self.scope.truth}" if self.scope.truth != "labels" else ""
        return f"{self.scope.what}-{self.scope.mode}{against}"


def as_json(report: Report) -> str:
    """Return the whole report as JSON with sorted keys; NaN and infinity become null."""
    return json.dumps(_plain(asdict(report)), sort_keys=True, indent=1, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def render(report: Report) -> Iterator[str | Table]:
    """Yield the lines and tables for the terminal, with an empty line before each table."""
    yield from _scope(report.scope)
    for table in _tables(report):
        yield ""
        yield table
    yield ""


def _tables(report: Report) -> Iterator[Table]:
    if report.detection:
        yield _detection(report.detection)
    if report.named:
        yield _named(report.named)
    if report.diagnosis:
        yield from _diagnosis(report.diagnosis)
    if report.tracking:
        yield _tracking(report.tracking)
    if report.flow:
        yield from _flow(report.flow)


def _scope(scope: Scope) -> Iterator[str]:
    area = scope.region
    region = [f"{area.length_m:g} x {area.width_m:g} m around the car"] if area else []
    against = ["against hand corrections"] if scope.truth != "labels" else []
    yield ", ".join([scope.what, scope.mode, "class-agnostic", *region, *against])
    yield f"drives {len(scope.segments)}, frames {scope.frames}, labels {scope.labels}, boxes {scope.boxes}"
    dropped = ", ".join(f"{items} {reason}" for reason, items in sorted(scope.dropped.items()) if items)
    if dropped:
        yield f"not counted: {dropped}"
    if scope.without_velocity and scope.mode == "moving-only":
        yield f"{scope.without_velocity} labels have no velocity and count as standing"
    for segment, reason in sorted(scope.left_out.items()):
        yield f"left out: {segment}: {reason}"


def _detection(scores: Sequence[DetectionScore]) -> Table:
    table = _table("", "labels", "AP L1", "AP L2", "APH L1", "APH L2", "precision", "recall")
    table.caption = "precision and recall (level 2) at the cut-off of the best F1"
    for score in scores:
        values = (*score.ap, *score.aph, score.precision, score.recall)
        name = f"AP@{score.iou:g}  {score.objects}"
        table.add_row(name, str(score.labels[1]), *map(_number, values))
    return table


def _named(scores: Sequence[NamedScore]) -> Table:
    table = _table("by name, level 2", "vehicles", "VRU", "mAP")
    table.caption = "VRU: walkers and riders"
    for score in scores:
        table.add_row(f"AP@{score.iou:g}", *map(_number, (score.vehicle, score.vru, score.mean)))
    return table


def _diagnosis(diagnosis: Diagnosis) -> Iterator[Table]:
    best = diagnosis.best
    if best:
        counts = {"right": best.right, "misplaced": best.localisation, "on the background": best.background}
        total = sum(counts.values())
        table = _table(f"best {total} boxes at IoU {diagnosis.iou:g}", "boxes", "share")
        for name, boxes in counts.items():
            table.add_row(name, str(boxes), _share(boxes, total))
        yield table
    table = _table(f"labels missed at IoU {diagnosis.iou:g}", "labels", "missed", "share")
    for group in diagnosis.misses:
        if group.labels:
            name = f"{group.split}: {group.group}" if group.split != "view" else group.group
            table.add_row(name, str(group.labels), str(group.missed), _share(group.missed, group.labels))
    yield table


def _tracking(scores: Sequence[TrackScore]) -> Table:
    table = _table("", "labels", "MOTA", "MOTP", "missed", "false", "mismatched", "score from")
    table.caption = "MOTP is the mean of 1 - IoU: lower is better"
    for score in scores:
        values = (score.mota, score.motp, score.miss, score.false_positive, score.mismatch)
        cutoff = "-" if score.cutoff is None else f"{score.cutoff:.2f}"
        name = f"IoU {score.iou:g}  L{score.level}"
        table.add_row(name, str(score.labels), *map(_number, values), cutoff)
    return table


def _flow(flow: FlowScore) -> Iterator[Table]:
    errors = flow.errors
    table = _table("flow", "EPE (m)", "points")
    names = ("moving objects", "standing objects", "background")
    means = (errors.dynamic_epe_m, errors.static_epe_m, errors.background_epe_m)
    for name, mean_m, points in zip(names, means, errors.points, strict=True):
        table.add_row(name, _number(mean_m), str(points))
    table.add_row("three-way mean", _number(errors.three_way_epe_m), str(sum(errors.points)))
    yield table
    table = _table("moving objects", "strict", "relaxed", "dynamic IoU")
    table.add_row("accuracy", *map(_number, (errors.strict, errors.relaxed, errors.dynamic_iou)))
    yield table
    table = _table("speed-normalised", "static (m)", "dynamic")
    for errors_of_class in flow.classes:
        static_epe_m, dynamic_error = errors_of_class.static_epe_m, errors_of_class.dynamic_error
        table.add_row(errors_of_class.name, _number(static_epe_m), _number(dynamic_error))
    table.add_row("mean over classes", "", _number(flow.mean_dynamic_error))
    yield table
    if flow.objects is not None:
        yield from _object_flow(flow.objects)


def _object_flow(score: ObjectFlowScore) -> Iterator[Table]:
    table = _table("flow of moving objects, 30 points or more", "objects", "right", "standing")
    for share in score.moving:
        table.add_row(share.name, str(share.objects), _number(share.right), _number(share.standing))
    yield table
    table = _table("flow of standing objects", "objects", "called moving", "of their points")
    counted = str(score.standing_objects)
    table.add_row("all", counted, _number(score.called_moving), _number(score.points_called_moving))
    yield table


def _table(first: str, *columns: str) -> Table:
    table = Table(box=None, pad_edge=False, caption_justify="left")
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table


def _number(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _share(part: int, total: int) -> str:
    return f"{part / total:.0%}" if total else "-"
