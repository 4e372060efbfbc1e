"""CLEAR-MOT on stories of a few frames: who is carried over, what is a mismatch, what is only a miss."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from streets import box, guesses, labels

from upvl_cli.errors import BadInput
from upvl_cli.metrics.waymo.breakdown import OBJECT_TYPE, RANGE, VELOCITY, Breakdown, moving_objects
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.official import SCORE_CUTOFFS
from upvl_cli.metrics.waymo.tracking import TrackingResult, tracking

HALF = (0.0, 0.5, 0.5, 0.5, 0.5)
Story = list[dict[str, float]]  # where each id stands in each frame


def scores(
    truth: Truth, predictions: Predictions, *splits: Breakdown, **rule: Any
) -> dict[str, TrackingResult]:
    """Results by name, at IoU 0.5 and the official cut-offs unless the rule says otherwise."""
    defaults = {"iou_thresholds": HALF, "score_cutoffs": SCORE_CUTOFFS, "matcher": "hungarian"}
    results = tracking(truth, predictions, **(defaults | rule), breakdowns=splits or [OBJECT_TYPE])
    return {result.name: result for result in results}


def car(truth: Truth, predictions: Predictions, level: int = 2, **rule: Any) -> TrackingResult:
    return scores(truth, predictions, **rule)[f"OBJECT_TYPE_TYPE_VEHICLE_LEVEL_{level}"]


def told(story: Story) -> dict[str, Any]:
    """Columns of the boxes of a story."""
    rows = [(frame, name, x) for frame, ids in enumerate(story) for name, x in ids.items()]
    return {
        "boxes": [box(x) for _, _, x in rows],
        "frame": [frame for frame, _, _ in rows],
        "object_id": [name for _, name, _ in rows],
    }


def counts(truth: Story, predictions: Story) -> tuple[int, int, int, int]:
    """Matches, misses, false positives and mismatches at cut-off 0."""
    c = car(labels(**told(truth)), guesses(**told(predictions))).counts
    return int(c.match[0]), int(c.miss[0]), int(c.false_positive[0]), int(c.mismatch[0])


STORIES = [
    ("followed", [{"a": 10}, {"a": 11}], [{"p": 10}, {"p": 11}], (2, 0, 0, 0)),
    ("another id takes over", [{"a": 10}, {"a": 10}], [{"p": 10}, {"q": 10}], (2, 0, 0, 1)),
    ("and back again", [{"a": 10}] * 3, [{"p": 10}, {"q": 10}, {"p": 10}], (3, 0, 0, 2)),
    (
        "the old id is kept though a new one fits better",
        [{"a": 10}, {"a": 10}],
        [{"p": 10}, {"p": 11, "q": 10}],
        (2, 0, 1, 0),
    ),
    (
        "the old id is dropped once it no longer reaches the threshold",
        [{"a": 10}, {"a": 10}],
        [{"p": 10}, {"p": 12, "q": 10}],
        (2, 0, 1, 1),
    ),
    (
        "remembered over a gap of the label",
        [{"a": 10}, {}, {"a": 10}],
        [{"p": 10}, {}, {"q": 10}],
        (2, 0, 0, 1),
    ),
    ("remembered over a gap of the id", [{"a": 10}] * 3, [{"p": 10}, {}, {"p": 10}], (2, 1, 0, 0)),
    ("swap", [{"a": 10, "b": 20}] * 2, [{"p": 10, "q": 20}, {"p": 20, "q": 10}], (4, 0, 0, 2)),
    (
        "the id goes to another label, the old one is gone: evicted",
        [{"a": 10}, {"b": 10}],
        [{"p": 10}, {"p": 10}],
        (2, 0, 0, 1),
    ),
    (
        "the id goes to another label, the old one is there: a miss only",
        [{"a": 10, "b": 20}, {"a": 10, "b": 20}],
        [{"p": 10}, {"p": 20}],
        (2, 2, 0, 0),
    ),
    (
        "one pair counts twice: its label had another id, its id another label that is gone",
        [{"a": 10, "b": 20}, {"a": 20}],
        [{"p": 10, "q": 20}, {"q": 20}],
        (3, 0, 0, 2),
    ),
    (
        "an evicted label starts anew",
        [{"a": 10}, {"b": 10}, {"a": 30, "b": 10}],
        [{"p": 10}, {"p": 10}, {"p": 10, "q": 30}],
        (4, 0, 0, 1),
    ),
    ("nothing there", [{"a": 10}], [{}], (0, 1, 0, 0)),
    ("nothing to find", [{}], [{"p": 10}], (0, 0, 1, 0)),
    ("nothing at all", [], [], (0, 0, 0, 0)),
]


@pytest.mark.parametrize(("name", "truth", "predictions", "expected"), STORIES, ids=[s[0] for s in STORIES])
def test_stories(name: str, truth: Story, predictions: Story, expected: tuple[int, ...]) -> None:
    assert counts(truth, predictions) == expected


def test_of_two_boxes_with_one_id_the_first_one_above_the_cutoff_counts() -> None:
    truth = labels([box(10)])
    c = car(truth, guesses([box(40), box(10)], object_id=["p", "p"], score=[0.3, 0.8])).counts
    assert (c.match[0], c.false_positive[0], c.miss[0]) == (0, 1, 1)  # the right one has vanished
    assert (c.match[31], c.false_positive[31], c.miss[31]) == (1, 0, 0)
    assert (c.match[81], c.false_positive[81], c.miss[81]) == (0, 0, 1)
    c = car(truth, guesses([box(10), box(40)], object_id=["p", "p"], score=[0.8, 0.3])).counts
    assert c.false_positive.sum() == 0


def test_a_label_twice_in_a_frame_is_refused() -> None:
    with pytest.raises(BadInput, match="segment s, frame 0: two labels have the id 'a'"):
        car(labels([box(10), box(20)], object_id=["a", "a"]), guesses([]))
    apart = labels([box(10), box(20)], object_id=["a", "a"], sequence=["s", "t"])
    assert car(apart, guesses([])).counts.miss[0] == 2


def test_the_lowest_cutoff_of_the_highest_mota_is_reported() -> None:
    truth = labels([box(10), box(20)])
    result = car(truth, guesses([box(10.5), box(20), box(50)], score=[0.9, 0.6, 0.25]))
    assert result.score_cutoff == float(np.float32(0.26))
    assert (result.mota, result.miss, result.false_positive, result.mismatch) == (1, 0, 0, 0)
    assert result.motp == pytest.approx((1 - 3.5 / 4.5) / 2)
    assert result.labels == 2


def test_mota_is_never_negative() -> None:
    result = car(labels([box(10)]), guesses([box(10), box(20), box(30)]))
    assert (result.mota, result.motp, result.miss, result.false_positive) == (0, 0, 0, 0)
    assert result.score_cutoff is None
    assert result.counts.false_positive[0] == 2


def test_levels() -> None:
    truth = labels([box(10), box(20), box(30)], level=[2, 2, 1])
    predictions = guesses([box(10)])
    one, two = (car(truth, predictions, level).counts for level in (1, 2))
    assert (one.truth[0], one.miss[0], one.match[0]) == (2, 1, 1)  # the matched level 2 is among them
    assert (two.truth[0], two.miss[0], two.match[0]) == (3, 2, 1)
    assert car(truth, predictions, 1).labels == 1


def test_a_box_over_an_unlabelled_zone_is_no_false_positive_but_can_be_matched() -> None:
    predictions = guesses([box(10), box(20), box(30)], unlabelled=[True, True, False])
    c = car(labels([box(10)]), predictions).counts
    assert (c.match[0], c.false_positive[0]) == (1, 1)


def test_segments_do_not_share_identities() -> None:
    truth = labels([box(10), box(10)], sequence=["s", "t"], object_id=["a", "a"])
    predictions = guesses([box(10), box(10)], sequence=["s", "t"], object_id=["p", "q"])
    assert car(truth, predictions).counts.mismatch[0] == 0


def test_a_range_shard_has_a_memory_of_its_own() -> None:
    story = [{"a": 10}, {"a": 40}, {"a": 10}]
    predictions = guesses(**told([{"p": 10}, {"q": 40}, {"p": 10}]))
    result = scores(labels(**told(story)), predictions, OBJECT_TYPE, RANGE)
    assert result["OBJECT_TYPE_TYPE_VEHICLE_LEVEL_2"].counts.mismatch[0] == 2
    assert result["RANGE_TYPE_VEHICLE_[0, 30)_LEVEL_2"].counts.mismatch[0] == 0


FAST = "VELOCITY_TYPE_VEHICLE_VERY_FAST_LEVEL_2"


@pytest.mark.parametrize(
    ("first_speed", "matches", "why"),
    [
        (np.nan, 2, "the first prediction has no speed: all get the nearest label's"),
        (0.0, 0, "it has one: each keeps its own, and none is standing"),
        (12.0, 1, "it has one, and the other none: standing"),
    ],
)
def test_predictions_without_speed(first_speed: float, matches: int, why: str) -> None:
    truth = labels([box(10), box(20)], velocity_mps=[[12, 0], [0, 12]])
    predictions = guesses([box(10), box(20)], velocity_mps=[[first_speed, 0], [np.nan, np.nan]])
    assert scores(truth, predictions, VELOCITY)[FAST].counts.match[0] == matches, why


def test_speeds_are_guessed_by_segment_and_from_the_first_frame() -> None:
    truth = labels([box(10), box(10)], frame=[1, 1], sequence=["s", "t"], velocity_mps=[[12, 0], [12, 0]])
    predictions = guesses([box(10), box(50), box(10)], frame=[1, 0, 1], sequence=["s", "t", "t"])
    found = scores(truth, predictions, VELOCITY)
    assert found[FAST].counts.match[0] == 2
    assert found["VELOCITY_TYPE_VEHICLE_STATIONARY_LEVEL_2"].counts.false_positive[0] == 1  # no label there
    empty_first = labels(
        [box(90), box(10)], frame=[0, 1], object_id=["a", "b"], velocity_mps=[[0, 0], [12, 0]]
    )
    assert scores(empty_first, guesses([box(10)], frame=[1]), VELOCITY)[FAST].counts.match[0] == 0


def test_each_segment_decides_for_itself_whether_its_predictions_have_speeds() -> None:
    """The first segment gives speeds (standing ones), the second none: only there the label's is taken."""
    truth = labels([box(10), box(10)], sequence=["s", "t"], velocity_mps=[[12, 0], [12, 0]])
    for order, matches in ((["s", "t"], 1), (["t", "s"], 1)):
        predictions = guesses([box(10), box(10)], sequence=order, velocity_mps=[[0, 0], [np.nan, np.nan]])
        assert scores(truth, predictions, VELOCITY)[FAST].counts.match[0] == matches


def test_moving_only_asks_both_sides() -> None:
    truth = labels([box(10), box(20)], velocity_mps=[[12, 0], [0, 0]])
    predictions = guesses([box(10), box(20)])
    c = scores(truth, predictions, moving_objects(min_speed_mps=1.0))["MOVING_TYPE_VEHICLE_LEVEL_2"].counts
    assert (c.match[0], c.miss[0], c.false_positive[0]) == (1, 0, 0)


def test_score_first_serves_by_score() -> None:
    truth = labels([box(10)])
    predictions = guesses([box(10), box(10.5)], score=[0.5, 0.9])
    assert car(truth, predictions).counts.cost[0] == 0
    assert car(truth, predictions, matcher="score_first").counts.cost[0] == pytest.approx(1 - 3.5 / 4.5)
