"""Scores of boxes and tracks by Waymo's definitions: of all objects, or of moving ones only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material
from upvl_cli.metrics.error_analysis import (
    MissedLabels,
    Outcome,
    TopOutcomes,
    classify_predictions,
    count_missed_labels,
    count_top_outcomes,
)
from upvl_cli.metrics.waymo.breakdown import OBJECT_TYPE, Breakdown, moving_objects
from upvl_cli.metrics.waymo.detection import DetectionResult, detection, match_boxes
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, map_types, speed_mps
from upvl_cli.metrics.waymo.official import LEVELS, NEAR_IOU, SCORE_CUTOFFS, TYPES
from upvl_cli.metrics.waymo.tracking import TrackingResult, tracking
from upvl_cli.types import Bools, Floats, Ints

_OBJECT, _OTHER = 1, 2  # types that stand for "an object" and, in the split of errors, "a standing one"
VRU = {4: 2}  # new type by type, the paper's vulnerable road users: cyclists count as pedestrians


@dataclass(frozen=True)
class DetectionScore:
    """Average precision of one group of objects at one IoU; pairs hold level 1 and level 2.

    Attributes:
        iou: Minimum 3D IoU of a match.
        objects: Group of labels and boxes by range; "all" for all of them.
        labels: Number of labels.
        ap: Average precision.
        aph: Average precision weighted by heading accuracy.
        precision: Precision at the cut-off of the highest F1, level 2.
        recall: Recall at the cut-off of the highest F1, level 2.
        cutoff: Score cut-off of the highest F1, level 2.
        curve_precision: Precision at each cut-off, level 2.
        curve_recall: Recall at each cut-off, level 2.
    """

    iou: float
    objects: str
    labels: tuple[int, int]
    ap: tuple[float, float]
    aph: tuple[float, float]
    precision: float
    recall: float
    cutoff: float
    curve_precision: tuple[float, ...]
    curve_recall: tuple[float, ...]


@dataclass(frozen=True)
class TrackScore:
    """CLEAR-MOT scores at one IoU and level, at the cut-off of the highest MOTA; see `TrackingResult`."""

    iou: float
    level: int
    mota: float
    motp: float
    miss: float
    false_positive: float
    mismatch: float
    cutoff: float | None
    labels: int


@dataclass(frozen=True)
class Diagnosis:
    """Analysis of errors at one IoU, with boxes of any score.

    Attributes:
        iou: 3D IoU from which a box is right.
        best: Kinds of the best-scored boxes; None without a label and a box.
        misses: Missed labels by points, range, view and speed.
    """

    iou: float
    best: TopOutcomes | None
    misses: list[MissedLabels]


def detection_scores(material: Material, settings: EvalConfig, *, moving_only: bool) -> list[DetectionScore]:
    """Return the average precision at each IoU, of all objects and by range.

    Each box and each label belongs to the range of its own centre, as in Waymo's breakdown by range.

    Args:
        material: Labels and boxes of one type.
        settings: IoUs, and bounds of speed and range.
        moving_only: Whether only moving labels count.
    """
    truth, _, _ = material.for_detection()
    predictions = material.predictions
    truth_group, names = _group_by_edges(_range_m(truth), settings.range_edges_m, "m")
    prediction_group, _ = _group_by_edges(_range_m(predictions), settings.range_edges_m, "m")
    groups = [("all", np.ones_like(truth_group, dtype=bool), np.ones_like(prediction_group, dtype=bool))]
    groups += [(name, truth_group == number, prediction_group == number) for number, name in enumerate(names)]
    breakdown = _breakdown(settings, moving_only)
    scores = []
    for iou in settings.iou:
        for name, labels, boxes in groups:
            results = _detection_by_level(truth[labels], predictions[boxes], iou, breakdown)
            scores.append(_detection_score(iou, name, _count_labels(truth[labels], breakdown), results))
    return scores


def named_scores(material: Material, *, iou: float, moving_mps: float | None) -> tuple[float, float, float]:
    """Return the average precision (level 2) of vehicles, of pedestrians and cyclists (VRU), and the mean of both.

    Args:
        material: Labels and boxes with types.
        iou: Minimum 3D IoU of a match.
        moving_mps: Speed from which a label counts; None counts all.
    """
    truth, predictions = map_types(material.for_detection()[0], VRU), map_types(material.predictions, VRU)
    results = detection(
        truth,
        predictions,
        iou_thresholds=(iou,) * len(TYPES),
        breakdowns=[OBJECT_TYPE if moving_mps is None else moving_objects(min_speed_mps=moving_mps)],
        score_cutoffs=SCORE_CUTOFFS,
        matcher="hungarian",
    )
    vehicles, vru = (results[len(LEVELS) * kind - 1].ap for kind in (1, 2))
    return vehicles, vru, (vehicles + vru) / 2


def track_scores(material: Material, settings: EvalConfig, *, moving_only: bool) -> list[TrackScore]:
    """Return the CLEAR-MOT scores at each IoU and level.

    Of labels and of boxes alike, those that move are chosen by their own speed, as Waymo's tracking tool does.

    Args:
        material: Labels and boxes of one type.
        settings: IoUs, and the bound of speed.
        moving_only: Whether only moving labels and boxes count.
    """
    scores = []
    for iou in settings.iou:
        results = tracking(
            material.labels,
            material.predictions,
            iou_thresholds=(iou,) * len(TYPES),
            breakdowns=[_breakdown(settings, moving_only)],
            score_cutoffs=SCORE_CUTOFFS,
            matcher="hungarian",
        )
        scores += [_track_score(iou, result) for result in results[: len(LEVELS)]]
    return scores


def diagnosis(material: Material, settings: EvalConfig, *, moving_only: bool) -> Diagnosis:
    """Return why boxes are wrong and which labels are missed.

    With `moving_only` a box that is matched with a standing label, or overlaps standing ones only, is neither
    right nor wrong.

    Args:
        material: Labels and boxes of one type.
        settings: IoUs, and the edges of the groups.
        moving_only: Whether only moving labels count.
    """
    truth, points, in_view = material.for_detection()
    counted = _breakdown(settings, moving_only).shard_of(truth) == 0
    matches = match_boxes(
        truth,
        material.predictions,
        iou_thresholds=(settings.right_iou,) * len(TYPES),
        score_cutoff=0.0,
        matcher="hungarian",
    )
    matched = matches.truth >= 0
    right = matched & np.append(counted, False)[matches.truth]
    predictions = replace(
        material.predictions,
        unlabelled=(matched & ~right)
        | _touches_uncounted_only(truth, material.predictions, counted, matched),
    )
    counted_truth = truth[counted]
    outcome = classify_predictions(counted_truth, predictions, right, min_overlap_iou=settings.overlap_iou)
    best = count_top_outcomes(counted_truth, predictions, outcome, top_share=settings.top_share)
    found = matches.prediction[counted] >= 0
    missed = count_missed_labels(
        found,
        points=points[counted],
        range_m=_range_m(counted_truth),
        in_view=in_view[counted],
        point_edges=settings.point_edges,
        range_edges_m=settings.range_edges_m,
    )
    missed += _missed_by_speed(counted_truth, found, settings.speed_edges_mps)
    return Diagnosis(
        settings.right_iou, next((outcomes for outcomes in best if outcomes.type == _OBJECT), None), missed
    )


def _touches_uncounted_only(truth: Truth, predictions: Predictions, counted: Bools, matched: Bools) -> Bools:
    """Return (m,) whether a box has no match and touches labels that do not count, and none that does."""
    kinds = replace(truth, type=np.where(counted, _OBJECT, _OTHER))
    touched = classify_predictions(kinds, predictions, matched, min_overlap_iou=NEAR_IOU)
    return np.asarray(touched == Outcome.OTHER_CLASS)


def _missed_by_speed(truth: Truth, found: Bools, edges_mps: Sequence[float]) -> list[MissedLabels]:
    group, names = _group_by_edges(speed_mps(truth.velocity_mps), edges_mps, "m/s")
    labels = np.bincount(group, minlength=len(names)).tolist()
    missed = np.bincount(group[~found], minlength=len(names)).tolist()
    return [MissedLabels("speed", *row) for row in zip(names, labels, missed, strict=True)]


def _breakdown(settings: EvalConfig, moving_only: bool) -> Breakdown:
    return moving_objects(min_speed_mps=settings.moving_mps) if moving_only else OBJECT_TYPE


def _detection_by_level(
    truth: Truth, predictions: Predictions, iou: float, breakdown: Breakdown
) -> tuple[DetectionResult, DetectionResult]:
    """Return level 1 and level 2 of the first shard: the objects."""
    first, second, *_ = detection(
        truth,
        predictions,
        iou_thresholds=(iou,) * len(TYPES),
        breakdowns=[breakdown],
        score_cutoffs=SCORE_CUTOFFS,
        matcher="hungarian",
    )
    return first, second


def _count_labels(truth: Truth, breakdown: Breakdown) -> tuple[int, int]:
    level = truth.level[breakdown.shard_of(truth) == 0]
    return int((level <= 1).sum()), len(level)


def _detection_score(
    iou: float, objects: str, labels: tuple[int, int], results: tuple[DetectionResult, DetectionResult]
) -> DetectionScore:
    first, second = results
    precision, recall = second.precision, second.recall
    best = int(np.argmax(2 * precision * recall / np.maximum(precision + recall, 1e-9)))
    return DetectionScore(
        iou=iou,
        objects=objects,
        labels=labels,
        ap=(first.ap, second.ap),
        aph=(first.aph, second.aph),
        # Where nothing is found the official precision is 1, which is for the curve only.
        precision=float(precision[best]) if recall[best] > 0 else 0.0,
        recall=float(recall[best]),
        cutoff=float(SCORE_CUTOFFS[best]),
        curve_precision=tuple(precision.tolist()),
        curve_recall=tuple(recall.tolist()),
    )


def _track_score(iou: float, result: TrackingResult) -> TrackScore:
    return TrackScore(
        iou=iou,
        level=result.level,
        mota=result.mota,
        motp=result.motp,
        miss=result.miss,
        false_positive=result.false_positive,
        mismatch=result.mismatch,
        cutoff=result.score_cutoff,
        labels=result.labels,
    )


def _range_m(boxes: Truth | Predictions) -> Floats:
    """Return (n,) distance of the centres from the ego origin, height included, as in Waymo's breakdown."""
    return np.asarray(np.linalg.norm(boxes.center_m, axis=1))


def _group_by_edges(values: Floats, edges: Sequence[float], unit: str) -> tuple[Ints, list[str]]:
    """Return (n,) group of each value, and the name of each group."""
    between = [f"[{low:g}, {high:g}) {unit}" for low, high in zip(edges, edges[1:], strict=False)]
    names = [f"below {edges[0]:g} {unit}", *between, f"from {edges[-1]:g} {unit}"]
    return np.searchsorted(edges, values, side="right"), names
