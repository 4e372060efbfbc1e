"""Scores boxes and tracks by Waymo's definitions, all objects or moving ones only, without classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.evaluation.gather import Material
from upvl_cli.metrics.breakdown import OBJECT_TYPE, Breakdown, moving
from upvl_cli.metrics.detection import DetectionResult, detection, match_boxes
from upvl_cli.metrics.errors import Misses, Outcome, TopOutcomes, misses, outcomes, top_outcomes
from upvl_cli.metrics.inputs import Predictions, Truth, relabelled, speed_mps
from upvl_cli.metrics.official import LEVELS, SCORE_CUTOFFS, TYPES
from upvl_cli.metrics.tracking import TrackingResult, tracking
from upvl_cli.types import Bools, Floats, Ints

_OBJECT, _OTHER = 1, 2  # types that stand for "an object" and, in the split of errors, "a standing one"
VRU = {4: 2}  # riders count as walkers
_NEAR_IOU = 0.01  # Waymo's: a false box this close to a label of another speed is that speed's


@dataclass(frozen=True)
class DetectionScore:
    """Average precision of one group of objects at one IoU; pairs hold level 1 and level 2.

    Attributes:
        iou: Least 3D IoU of a match.
        objects: Which labels and boxes, by range; "all" for all of them.
        labels: How many labels count.
        ap: Average precision.
        aph: The same, weighted by heading.
        precision: At the cut-off of the highest F1, level 2.
        recall: At the same one.
        cutoff: That cut-off.
        curve_precision: One value a cut-off, level 2.
        curve_recall: The same for the recall.
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
    """Why boxes are wrong, and which labels are missed, at the IoU `iou` and with boxes of any score.

    Attributes:
        iou: From this 3D IoU on a box is right.
        best: What the best-scored boxes are; None without a label and a box.
        misses: Labels missed, by points, range, view and speed.
    """

    iou: float
    best: TopOutcomes | None
    misses: list[Misses]


def detection_scores(material: Material, settings: EvalConfig, *, moving_only: bool) -> list[DetectionScore]:
    """Average precision at each IoU, of all objects and by range.

    Boxes and labels are put to a range each by its own centre, as in Waymo's breakdown by range.

    Args:
        material: What is scored.
        settings: IoUs, and bounds of speed and range.
        moving_only: Whether only labels that move are asked for.
    """
    truth, _, _ = material.for_detection()
    predictions = material.predictions
    of_truth, names = _by_range(truth, settings.range_edges_m)
    of_prediction, _ = _by_range(predictions, settings.range_edges_m)
    groups = [("all", np.ones_like(of_truth, dtype=bool), np.ones_like(of_prediction, dtype=bool))]
    groups += [(name, of_truth == number, of_prediction == number) for number, name in enumerate(names)]
    breakdown = _breakdown(settings, moving_only)
    scores = []
    for iou in settings.iou:
        for name, labels, boxes in groups:
            results = _scored(truth[labels], predictions[boxes], iou, breakdown)
            scores.append(_score(iou, name, _count(truth[labels], breakdown), results))
    return scores


def named_scores(material: Material, *, iou: float, moving_mps: float | None) -> tuple[float, float, float]:
    """Average precision (level 2) of vehicles, of walkers and riders together (VRU), and the mean of both.

    Args:
        material: What is scored, with classes.
        iou: Least 3D IoU of a match.
        moving_mps: Only labels at least this fast are asked for; None takes all.
    """
    truth, predictions = relabelled(material.for_detection()[0], VRU), relabelled(material.predictions, VRU)
    results = detection(
        truth,
        predictions,
        iou_thresholds=(iou,) * len(TYPES),
        breakdowns=[OBJECT_TYPE if moving_mps is None else moving(min_speed_mps=moving_mps)],
        score_cutoffs=SCORE_CUTOFFS,
        matcher="hungarian",
    )
    vehicles, vru = (results[len(LEVELS) * kind - 1].ap for kind in (1, 2))
    return vehicles, vru, (vehicles + vru) / 2


def track_scores(material: Material, settings: EvalConfig, *, moving_only: bool) -> list[TrackScore]:
    """CLEAR-MOT at each IoU and level; moving tracks are chosen by their own speed, as Waymo does.

    Args:
        material: What is scored.
        settings: IoUs, and the bound of speed.
        moving_only: Whether only what moves counts.
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
    """Why boxes are wrong and which labels are missed.

    With `moving_only` a box that is matched with a standing label, or overlaps standing ones only, is neither
    right nor wrong.

    Args:
        material: What is scored.
        settings: IoUs and bounds.
        moving_only: Whether only labels that move are asked for.
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
        unlabelled=(matched & ~right) | _near_others_only(truth, material.predictions, counted, matched),
    )
    asked = truth[counted]
    outcome = outcomes(asked, predictions, right, least_iou=settings.overlap_iou)
    best = top_outcomes(asked, predictions, outcome, top_share=settings.top_share)
    found = matches.prediction[counted] >= 0
    missed = misses(
        found,
        points=points[counted],
        range_m=_range_m(asked),
        in_view=in_view[counted],
        point_edges=settings.point_edges,
        range_edges_m=settings.range_edges_m,
    )
    missed += _missed_by_speed(asked, found, settings.speed_edges_mps)
    return Diagnosis(settings.right_iou, next((of for of in best if of.type == _OBJECT), None), missed)


def _near_others_only(truth: Truth, predictions: Predictions, counted: Bools, matched: Bools) -> Bools:
    """(m,) boxes without a match that touch labels that do not count, and none that does."""
    kinds = replace(truth, type=np.where(counted, _OBJECT, _OTHER))
    touched = outcomes(kinds, predictions, matched, least_iou=_NEAR_IOU)
    return np.asarray(touched == Outcome.OTHER_CLASS)


def _missed_by_speed(truth: Truth, found: Bools, edges_mps: Sequence[float]) -> list[Misses]:
    group, names = _groups(speed_mps(truth.velocity_mps), edges_mps, "m/s")
    labels = np.bincount(group, minlength=len(names)).tolist()
    missed = np.bincount(group[~found], minlength=len(names)).tolist()
    return [Misses("speed", *row) for row in zip(names, labels, missed, strict=True)]


def _breakdown(settings: EvalConfig, moving_only: bool) -> Breakdown:
    return moving(min_speed_mps=settings.moving_mps) if moving_only else OBJECT_TYPE


def _scored(
    truth: Truth, predictions: Predictions, iou: float, breakdown: Breakdown
) -> tuple[DetectionResult, DetectionResult]:
    """Level 1 and level 2 of the first shard: the objects."""
    first, second, *_ = detection(
        truth,
        predictions,
        iou_thresholds=(iou,) * len(TYPES),
        breakdowns=[breakdown],
        score_cutoffs=SCORE_CUTOFFS,
        matcher="hungarian",
    )
    return first, second


def _count(truth: Truth, breakdown: Breakdown) -> tuple[int, int]:
    level = truth.level[breakdown.shard_of(truth) == 0]
    return int((level <= 1).sum()), len(level)


def _score(
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


def _by_range(boxes: Truth | Predictions, edges_m: Sequence[float]) -> tuple[Ints, list[str]]:
    return _groups(_range_m(boxes), edges_m, "m")


def _range_m(boxes: Truth | Predictions) -> Floats:
    """(n,) distance of the centres from the origin of the car, height included, as in Waymo's breakdown."""
    return np.asarray(np.linalg.norm(boxes.seven[:, :3], axis=1))


def _groups(values: Floats, edges: Sequence[float], unit: str) -> tuple[Ints, list[str]]:
    """(n,) group of each value, and the name of each group."""
    between = [f"[{low:g}, {high:g}) {unit}" for low, high in zip(edges, edges[1:], strict=False)]
    names = [f"below {edges[0]:g} {unit}", *between, f"from {edges[-1]:g} {unit}"]
    return np.searchsorted(edges, values, side="right"), names
