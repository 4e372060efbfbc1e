"""Average precision on frames small enough to count by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from streets import box, guesses, labels

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.breakdown import (
    OBJECT_TYPE,
    ONE_SHARD,
    RANGE,
    SIZE,
    VELOCITY,
    Breakdown,
    moving_objects,
)
from upvl_cli.metrics.waymo.detection import DetectionResult, detection, match_boxes
from upvl_cli.metrics.waymo.heading import heading_accuracy
from upvl_cli.metrics.waymo.inputs import Predictions, Truth, map_types, resolve_level, speed_mps
from upvl_cli.metrics.waymo.official import SCORE_CUTOFFS

HALF = (0.0, 0.5, 0.5, 0.5, 0.5)
FAST = [[12.0, 0.0]]


def scores(
    truth: Truth, predictions: Predictions, *splits: Breakdown, **rule: Any
) -> dict[str, DetectionResult]:
    """Results by name, at IoU 0.5 and the official cut-offs unless the rule says otherwise."""
    defaults = {"iou_thresholds": HALF, "score_cutoffs": SCORE_CUTOFFS, "matcher": "hungarian"}
    results = detection(truth, predictions, **(defaults | rule), breakdowns=splits or [OBJECT_TYPE])
    return {result.name: result for result in results}


def counts(result: DetectionResult, cutoff: int = 0) -> tuple[int, int, int]:
    return int(result.tp[cutoff]), int(result.fp[cutoff]), int(result.fn[cutoff])


def car(truth: Truth, predictions: Predictions, level: int = 1, **rule: Any) -> DetectionResult:
    return scores(truth, predictions, **rule)[f"OBJECT_TYPE_TYPE_VEHICLE_LEVEL_{level}"]


def test_perfect_predictions_score_1() -> None:
    truth = labels([box(10), box(20), box(30)])
    result = car(truth, guesses(truth.to_rows()))
    assert (result.ap, result.aph, counts(result)) == (1.0, 1.0, (3, 0, 0))
    assert result.recall[0] == result.precision[0] == 1
    assert result.sum_ha[0] == 3


@pytest.mark.parametrize(
    ("score", "used_until"),
    [(0.0, 1), (0.3, 31), (np.float32(0.29), 30), (1.0, 101), (1.7, 101), (-0.1, 0), (0.305, 31)],
)
def test_a_score_on_a_cutoff_is_kept(score: float, used_until: int) -> None:
    result = car(labels([box(10)]), guesses([box(10)], score=[score]))
    assert result.tp.sum() == used_until
    assert (result.fn == 1 - result.tp).all()


def test_levels_decide_only_which_unmatched_labels_are_missed() -> None:
    truth = labels([box(10), box(20), box(30), box(40)], level=[2, 2, 1, 0])
    predictions = guesses([box(10)])
    assert counts(car(truth, predictions, level=1)) == (1, 0, 2)  # the matched level 2 is a hit here too
    assert counts(car(truth, predictions, level=2)) == (1, 0, 3)


def test_a_box_over_an_unlabelled_zone_is_no_false_positive_but_can_be_right() -> None:
    truth = labels([box(10)])
    predictions = guesses([box(10), box(20), box(30)], unlabelled=[True, True, False])
    assert counts(car(truth, predictions)) == (1, 1, 0)


def test_heading_weighs_matches_and_leaves_recall() -> None:
    truth = labels([box(10), box(20)])
    result = car(truth, guesses([box(10, heading=math.pi), box(20, heading=2 * math.pi)]))
    assert (result.ap, result.aph) == (1.0, pytest.approx(0.5))


@pytest.mark.parametrize(
    ("a", "b", "accuracy"),
    [
        (0, 0, 1),
        (0, math.pi, 0),
        (0, math.pi / 2, 0.5),
        (3, 3 - 2 * math.pi, 1),
        (-3.1, 3.1, 1 - (0.0831853 / math.pi)),
    ],
)
def test_heading_accuracy(a: float, b: float, accuracy: float) -> None:
    assert heading_accuracy(np.array([a]), np.array([b]))[0] == pytest.approx(accuracy, abs=1e-6)


def test_maximum_weight_not_scores_decides() -> None:
    truth = labels([box(10)])
    predictions = guesses([box(10.5), box(10.1)], score=[0.9, 0.5])
    result = car(truth, predictions)
    assert (result.tp[0], result.tp[60]) == (1, 1)  # above 0.5 the farther box takes the label over
    matched = match_boxes(truth, predictions, iou_thresholds=HALF, score_cutoff=0.0, matcher="hungarian")
    assert matched.truth.tolist() == [-1, 0]
    high = match_boxes(truth, predictions, iou_thresholds=HALF, score_cutoff=0.6, matcher="hungarian")
    assert high.truth.tolist() == [0, -2]
    first = match_boxes(truth, predictions, iou_thresholds=HALF, score_cutoff=0.0, matcher="score_first")
    assert first.truth.tolist() == [0, -1]
    assert first.iou[0] == pytest.approx(3.5 / 4.5)


def test_matches_are_given_in_the_callers_order() -> None:
    truth = labels([box(10), box(20), box(30)], frame=[2, 0, 1])
    predictions = guesses([box(30), box(20), box(10), box(90)], frame=[1, 0, 2, 7])
    matched = match_boxes(truth, predictions, iou_thresholds=HALF, score_cutoff=0.0, matcher="hungarian")
    assert matched.truth.tolist() == [2, 1, 0, -1]
    assert matched.prediction.tolist() == [2, 1, 0]
    assert matched.iou.tolist() == [1, 1, 1, 0]


def test_types_never_cross() -> None:
    result = scores(labels([box(10)], type=[2]), guesses([box(10)], type=[1]), OBJECT_TYPE, ONE_SHARD)
    assert counts(result["OBJECT_TYPE_TYPE_VEHICLE_LEVEL_2"]) == (0, 1, 0)
    assert counts(result["OBJECT_TYPE_TYPE_PEDESTRIAN_LEVEL_2"]) == (0, 0, 1)
    assert counts(result["ONE_SHARD_LEVEL_2"]) == (0, 1, 1)


def test_relabelling_merges_types() -> None:
    truth, predictions = labels([box(10)], type=[4]), guesses([box(10)], type=[2])
    merged = scores(map_types(truth, {4: 2}), map_types(predictions, {4: 2}))
    assert counts(merged["OBJECT_TYPE_TYPE_PEDESTRIAN_LEVEL_2"]) == (1, 0, 0)
    agnostic = {2: 1, 3: 1, 4: 1}
    assert counts(car(map_types(truth, agnostic), map_types(predictions, agnostic))) == (1, 0, 0)


def test_a_pair_across_a_range_border_counts_on_both_sides() -> None:
    result = scores(labels([[29.9, 0, 0, 4, 2, 1.5, 0]]), guesses([[30.0, 0, 0, 4, 2, 1.5, 0]]), RANGE)
    assert counts(result["RANGE_TYPE_VEHICLE_[0, 30)_LEVEL_2"]) == (0, 0, 1)
    assert counts(result["RANGE_TYPE_VEHICLE_[30, 50)_LEVEL_2"]) == (0, 1, 0)


def test_range_is_the_3d_distance_and_size_the_longest_side() -> None:
    truth = labels([[18, 24, 0, 4, 2, 1.5, 0], [0, 0, 50, 7, 2, 1.5, 0], [0, 0, 1, 2, 2, 6.9, 0]])
    assert RANGE.shard_of(truth).tolist() == [1, 2, 0]
    assert SIZE.shard_of(truth).tolist() == [0, 1, 0]


@pytest.mark.parametrize(
    ("speed", "shard"),
    [(0.0, 0), (0.19, 0), (0.21, 1), (1.0, 2), (3.0, 3), (9.99, 3), (10.0, 4), (np.nan, 0)],
)
def test_speed_shards(speed: float, shard: int) -> None:
    truth = labels([box(10)], type=[4], velocity_mps=[[speed, 0.0]])
    assert VELOCITY.shard_of(truth).tolist() == [15 + shard]
    assert speed_mps(np.array([[3.0, -4.0]])).tolist() == [5.0]


def test_speed_shards_ask_the_labels_only() -> None:
    truth = labels([box(10), box(20)], velocity_mps=[[12, 0], [0, 0]])
    predictions = guesses([box(10), box(22.5), box(60)])  # right; touches the parked car; touches nothing
    result = scores(truth, predictions, VELOCITY)
    assert counts(result["VELOCITY_TYPE_VEHICLE_VERY_FAST_LEVEL_2"]) == (1, 1, 0)
    assert counts(result["VELOCITY_TYPE_VEHICLE_STATIONARY_LEVEL_2"]) == (0, 2, 1)
    assert counts(result["VELOCITY_TYPE_VEHICLE_SLOW_LEVEL_2"]) == (0, 1, 0)


def test_moving_only_follows_the_speed_rule() -> None:
    truth = labels([box(10), box(20), box(40)], velocity_mps=[[12, 0], [0, 0], [0.5, 0]])
    predictions = guesses([box(10), box(20), box(22.5), box(60)])
    name = "MOVING_TYPE_VEHICLE_LEVEL_2"
    assert counts(scores(truth, predictions, moving_objects(min_speed_mps=1.0))[name]) == (1, 1, 0)
    assert counts(scores(truth, predictions, moving_objects(min_speed_mps=0.2))[name]) == (1, 1, 1)


def test_segments_and_frames_do_not_mix() -> None:
    truth = labels([box(10), box(10)], sequence=["a", "b"], frame=[3, 3])
    assert counts(car(truth, guesses([box(10), box(10)], sequence=["a", "c"], frame=[3, 3]))) == (1, 1, 1)
    assert counts(car(truth, guesses([box(10), box(10)], sequence=["a", "b"], frame=[3, 4]))) == (1, 1, 1)


@pytest.mark.parametrize(("truths", "found"), [(0, 0), (0, 2), (2, 0)])
def test_empty_sides(truths: int, found: int) -> None:
    boxes = [box(10), box(20)]
    splits = OBJECT_TYPE, RANGE, SIZE, VELOCITY, ONE_SHARD, moving_objects(min_speed_mps=1.0)
    truth, predictions = labels(boxes[:truths]), guesses(boxes[:found])
    result = scores(truth, predictions, *splits)
    assert len(result) == 2 * (4 + 12 + 8 + 20 + 1 + 4)
    assert all(r.ap == r.aph == 0 for r in result.values())
    assert counts(result["OBJECT_TYPE_TYPE_VEHICLE_LEVEL_2"]) == (0, found, truths)
    matched = match_boxes(truth, predictions, iou_thresholds=HALF, score_cutoff=0.0, matcher="hungarian")
    assert matched.truth.tolist() == [-1] * found
    assert matched.prediction.tolist() == [-1] * truths


def test_levels_of_the_tool() -> None:
    levels = resolve_level(np.array([0, 0, 0, 1, 2, 0]), np.array([6, 5, 1, 2, 100, -1]))
    assert levels.tolist() == [1, 2, 2, 1, 2, 1]
    assert resolve_level(np.array([], dtype=int), np.array([], dtype=int)).tolist() == []


NAN_BOX = [math.nan, *box(0)[1:]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: labels([box(1), NAN_BOX], frame=[3, 4]),
            "label 1 .segment s, frame 4. has a box that is not",
        ),
        (lambda: guesses([[math.inf, *box(0)[1:]]]), "prediction 0 .* not finite"),
        (lambda: guesses([box(1)], score=[math.nan]), "prediction 0 .* score that is not a number"),
        (lambda: labels([box(1)], level=[3]), "label 0 .* level, expected 0, 1 or 2"),
        (lambda: labels([box(1)], type=[5]), "label 0 .* type, expected 0 to 4"),
        (lambda: guesses([box(1)], type=[-1]), "prediction 0 .* type, expected 0 to 4"),
        (
            lambda: car(labels([]), guesses([]), iou_thresholds=(0, 0, 0, 0, 0)),
            "IoU thresholds .* expected five",
        ),
        (lambda: car(labels([]), guesses([]), iou_thresholds=(0.5,)), "IoU thresholds .* expected five"),
        (lambda: car(labels([]), guesses([]), iou_thresholds=(0, math.nan, 1, 1, 1)), "IoU thresholds"),
        (
            lambda: car(labels([]), guesses([]), score_cutoffs=np.array([0.5, 0.1])),
            "cut-offs must be ascending",
        ),
        (lambda: car(labels([]), guesses([]), score_cutoffs=np.array([])), "cut-offs must be ascending"),
    ],
)
def test_bad_input_is_refused_in_one_line(make: Any, message: str) -> None:
    with pytest.raises(BadInput, match=message) as error:
        make()
    assert "\n" not in str(error.value)
