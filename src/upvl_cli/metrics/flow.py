"""Scene-flow errors of one pair of sweeps, and the speed-normalised score over many.

Flow here is a displacement over the interval of the pair, in metres, with the car's own motion taken out.

Three-way EPE, accuracies and dynamic IoU: as the Argoverse 2 package evaluates them (av2-api,
evaluation/scene_flow/eval.py), a point being dynamic from 5 cm an interval on.

Bucket-normalised EPE: Khatri et al., I Can't Believe It's Not Scene Flow, ECCV 2024, as the Argoverse 2
2024 challenge scores it (kylevedder/BucketedSceneFlowEval, eval/bucketed_epe.py). Taken from there: the
classes background, car, other vehicles, pedestrian, wheeled VRU (road signs are left out); 50 buckets of
true speed from 0 to 20 m/s, 0.4 m/s wide, and one above; the first bucket is static and keeps its EPE in
metres, every other one divides its mean EPE by its mean true displacement; a class's dynamic error is the
plain mean over its buckets that hold points, the score the plain mean over classes; points of all sweeps
count together. The challenge takes points with |x|, |y| < 35 m without ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.types import Array, Bools, Floats, Ints

# Argoverse 2's, av2-api evaluation/scene_flow/constants.py; they define the scores, so no setting changes them.
DYNAMIC_M = 0.05  # displacement over the interval from which a point is dynamic
_STRICT, _RELAXED = 0.05, 0.10  # error in metres, or as a share of the true total flow
# The challenge's, BucketedSceneFlowEval.
_MAX_BUCKET_SPEED_MPS, _BUCKETS = 20.0, 50


@dataclass(frozen=True)
class FlowErrors:
    """Errors of one pair of sweeps; NaN where no point counts.

    Attributes:
        three_way_epe_m: Mean of the next three.
        dynamic_epe_m: Mean end-point error of moving foreground points.
        static_epe_m: The same for standing foreground points.
        background_epe_m: The same for standing background points.
        strict: Share of moving foreground points with an error below 5 cm or 5 % of the total flow.
        relaxed: The same for 10 cm or 10 %.
        dynamic_iou: IoU of the points that the prediction moves with those that move.
        points: How many points the three means are of, in their order.
    """

    three_way_epe_m: float
    dynamic_epe_m: float
    static_epe_m: float
    background_epe_m: float
    strict: float
    relaxed: float
    dynamic_iou: float
    points: tuple[int, int, int]


@dataclass(frozen=True)
class FlowBuckets:
    """Sums over points by class and speed; those of several pairs of sweeps add up.

    Attributes:
        count: (c, 51) points.
        error_m: (c, 51) sum of end-point errors.
        displacement_m: (c, 51) sum of true displacements.
    """

    count: Ints
    error_m: Floats
    displacement_m: Floats

    def __add__(self, addend: FlowBuckets) -> FlowBuckets:
        return FlowBuckets(
            self.count + addend.count,
            self.error_m + addend.error_m,
            self.displacement_m + addend.displacement_m,
        )


@dataclass(frozen=True)
class BucketScore:
    """Errors by class, and their means over classes; NaN where no point counts.

    Attributes:
        static_epe_m: (c,) mean end-point error of points slower than 0.4 m/s.
        dynamic_error: (c,) share of the motion that is not described; 1 for a prediction of no motion.
        mean_static_epe_m: Mean of `static_epe_m`.
        mean_dynamic_error: Mean of `dynamic_error`: the score that methods are ranked by.
        by_speed: (c, 51) error of each bucket, in metres in the first column and normalised in the rest.
    """

    static_epe_m: Floats
    dynamic_error: Floats
    mean_static_epe_m: float
    mean_dynamic_error: float
    by_speed: Floats


def flow_errors(
    predicted_m: Array,
    true_m: Array,
    *,
    true_total_m: Array,
    foreground: Bools,
    dynamic: Bools,
    evaluated: Bools,
) -> FlowErrors:
    """Return the errors of a predicted flow over one pair of sweeps.

    Args:
        predicted_m: (n, 3) predicted flow.
        true_m: (n, 3) true flow.
        true_total_m: (n, 3) true flow with the car's motion in it: what the accuracies are relative to.
        foreground: (n,) whether a point is on a labelled object.
        dynamic: (n,) whether a point truly moves.
        evaluated: (n,) whether a point counts: its truth is known, it is near and not ground.

    Raises:
        BadInput: The prediction is not finite, or has not one row a point.
    """
    predicted_m, true_m = _check(predicted_m, true_m)
    foreground, dynamic, evaluated = (
        np.asarray(mask, dtype=np.bool_) for mask in (foreground, dynamic, evaluated)
    )
    error_m = np.linalg.norm(predicted_m - true_m, axis=1)
    moving = evaluated & foreground & dynamic
    standing, background = evaluated & foreground & ~dynamic, evaluated & ~foreground & ~dynamic
    moving_m, standing_m, background_m = (_mean(error_m[part]) for part in (moving, standing, background))

    total_m = np.linalg.norm(np.asarray(true_total_m, dtype=np.float64).reshape(-1, 3)[moving], axis=1)
    relative = error_m[moving] / (total_m + 1e-10)  # the term of the Argoverse 2 package
    strict, relaxed = (_mean((error_m[moving] < bound) | (relative < bound)) for bound in (_STRICT, _RELAXED))

    predicted_dynamic = (np.linalg.norm(predicted_m, axis=1) >= DYNAMIC_M)[evaluated]
    either = int(np.count_nonzero(predicted_dynamic | dynamic[evaluated]))
    return FlowErrors(
        three_way_epe_m=(moving_m + standing_m + background_m) / 3,
        dynamic_epe_m=moving_m,
        static_epe_m=standing_m,
        background_epe_m=background_m,
        strict=strict,
        relaxed=relaxed,
        dynamic_iou=int(np.count_nonzero(predicted_dynamic & dynamic[evaluated])) / max(either, 1),
        points=(int(moving.sum()), int(standing.sum()), int(background.sum())),
    )


def flow_buckets(
    predicted_m: Array, true_m: Array, *, group: Array, groups: int, interval_s: float
) -> FlowBuckets:
    """Return the sums of one pair of sweeps for the speed-normalised score.

    Args:
        predicted_m: (n, 3) predicted flow.
        true_m: (n, 3) true flow.
        group: (n,) class of each point, -1 where it does not count.
        groups: How many classes there are.
        interval_s: Time between the sweeps: speed is displacement over it.

    Raises:
        BadInput: The prediction is not finite, or has not one row a point, or a class is unknown.
    """
    predicted_m, true_m = _check(predicted_m, true_m)
    group = np.asarray(group, dtype=np.int64)
    if group.max(initial=-1) >= groups:
        raise BadInput(f"a point of class {group.max()}, expected 0 to {groups - 1}, or -1 where none counts")
    counts = group >= 0
    displacement_m = np.linalg.norm(true_m, axis=1)[counts]
    error_m = np.linalg.norm(predicted_m - true_m, axis=1)[counts]
    edges_m = np.linspace(0, _MAX_BUCKET_SPEED_MPS * interval_s, _BUCKETS + 1)
    bucket = np.searchsorted(edges_m, displacement_m, side="right") - 1
    place, places = group[counts] * (_BUCKETS + 1) + bucket, groups * (_BUCKETS + 1)
    weights = np.ones(len(place)), error_m, displacement_m
    sums = (np.bincount(place, weight, places).reshape(groups, -1) for weight in weights)
    count, error_sum_m, displacement_sum_m = (np.asarray(total, dtype=np.float64) for total in sums)
    return FlowBuckets(count.astype(np.int64), error_sum_m, displacement_sum_m)


def bucket_score(buckets: FlowBuckets) -> BucketScore:
    """Return the speed-normalised score of all points that were added up.

    Args:
        buckets: Sums of any number of pairs of sweeps.
    """
    by_speed: Floats = np.full(buckets.error_m.shape, np.nan)
    filled = buckets.count > 0
    normalizer = np.where(np.arange(by_speed.shape[1]) == 0, buckets.count, buckets.displacement_m)
    by_speed[filled] = buckets.error_m[filled] / normalizer[filled]
    dynamic_error = np.array([_mean(row[~np.isnan(row)]) for row in by_speed[:, 1:]])
    static_epe_m = by_speed[:, 0].copy()
    static, dynamic = (_mean(errors[~np.isnan(errors)]) for errors in (static_epe_m, dynamic_error))
    return BucketScore(static_epe_m, dynamic_error, static, dynamic, by_speed)


def _check(predicted_m: Array, true_m: Array) -> tuple[Floats, Floats]:
    predicted_m = np.asarray(predicted_m, dtype=np.float64).reshape(-1, 3)
    true_m = np.asarray(true_m, dtype=np.float64).reshape(-1, 3)
    if predicted_m.shape != true_m.shape:
        raise BadInput(f"flow of {len(predicted_m)} points against truth of {len(true_m)}, expected as many")
    if not np.isfinite(predicted_m).all():
        row = int(np.flatnonzero(~np.isfinite(predicted_m).all(axis=1))[0])
        raise BadInput(f"flow of point {row} is not finite: {predicted_m[row].tolist()}; expected metres")
    return predicted_m, true_m


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
