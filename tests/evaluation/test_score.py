"""Scores of boxes that a person can check: cars of 4 m, so a shift of 1 m along them is an IoU of 3 / 5."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scored_world import SETTINGS, material

from upvl_cli.errors import BadInput
from upvl_cli.evaluation.score import detection_scores, diagnosis, track_scores

ONE_IOU = replace(SETTINGS, iou=(0.4,))
MOVING, STANDING = 5.0, 0.5


def whole(labels, boxes, *, moving_only=True, **more):
    """The scores over all ranges at IoU 0.4."""
    return detection_scores(material(labels, boxes, **more), ONE_IOU, moving_only=moving_only)[0]


def test_half_found_before_anything_false_is_a_half() -> None:
    labels = [(frame, 10.0, 0.0, MOVING) for frame in range(4)]
    # Right, right (IoU 0.6), too far off (2 m: IoU 1/3) and on nothing: from the second on recall stays 1/2.
    boxes = [(0, 10, 0, 0.9), (1, 11, 0, 0.85), (2, 12, 0, 0.8), (3, 10, 20, 0.3)]
    score = whole(labels, boxes)
    assert score.ap == pytest.approx((0.5, 0.5))
    assert score.aph == pytest.approx((0.5, 0.5))
    assert score.labels == (4, 4)
    assert (score.precision, score.recall) == (1.0, 0.5)
    assert score.cutoff == pytest.approx(0.81)  # the first cut-off without the third box


@pytest.mark.parametrize(
    ("box", "false"),
    [
        ((0, 30, 0, 0.9), 0),  # on the standing label: another's match
        ((0, 33.8, 0, 0.9), 0),  # IoU 0.2 / 7.8 with it: too little for a match, but it is near that label
        ((0, 33.98, 0, 0.9), 1),  # IoU 0.02 / 7.98: below 0.01, so on nothing
        ((0, 50, 0, 0.9), 1),  # on nothing
    ],
)
def test_moving_only_asks_moving_labels_and_passes_over_what_stands(box, false) -> None:
    labels = [(0, 10, 0, MOVING), (0, 30, 0, STANDING)]
    score = whole(labels, [(0, 10, 0, 0.5), box])
    assert score.labels == (1, 1)
    assert score.curve_recall[0] == 1.0
    assert score.curve_precision[0] == pytest.approx(1 / (1 + false))


def test_all_motion_asks_standing_labels_too() -> None:
    labels = [(0, 10, 0, MOVING), (0, 30, 0, STANDING)]
    assert whole(labels, [(0, 10, 0, 0.5)], moving_only=False).curve_recall[0] == 0.5


def test_an_object_moves_from_the_very_bound_on() -> None:
    assert whole([(0, 10, 0, 1.0), (0, 30, 0, 0.99)], []).labels == (1, 1)


def test_levels_follow_points_and_labels_without_points_are_gone() -> None:
    labels = [(0, 10, 0, MOVING), (0, 20, 0, MOVING), (0, 30, 0, MOVING), (0, 40, 0, MOVING)]
    score = whole(labels, [(0, 10, 0, 0.9)], points=[6, 5, 0, -1])
    assert score.labels == (
        2,
        3,
    )  # six points are easy, five are hard, none is gone, unknown counts everywhere


def test_ranges_cut_each_side_by_its_own_centre() -> None:
    labels = [(0, 29.5, 0, MOVING), (1, 10, 0, MOVING)]
    boxes = [(0, 30.5, 0, 0.9), (1, 10, 0, 0.8)]
    scores = detection_scores(material(labels, boxes), ONE_IOU, moving_only=True)
    assert [score.objects for score in scores] == ["all", "below 30 m", "[30, 50) m", "from 50 m"]
    assert [score.labels[1] for score in scores] == [2, 2, 0, 0]
    assert scores[0].curve_recall[0] == 1.0
    assert scores[1].curve_recall[0] == 0.5  # the pair that straddles 30 m is a miss on this side of it
    assert scores[2].recall == 0.0  # and false on the other


def test_where_nothing_is_found_the_precision_is_zero() -> None:
    """The official tool gives 1 there, for its curve only."""
    score = whole([(0, 10, 0, MOVING)], [(0, 10, 30, 0.9)])
    assert (score.precision, score.recall, score.ap) == (0.0, 0.0, (0.0, 0.0))


def test_the_reported_precision_and_recall_are_those_of_the_best_f1_at_level_2() -> None:
    # An easy label is found at .9 and a hard one at .5, with a false box at .7: F1 is 2/3, 1/2, then 4/5.
    labels, boxes = (
        [(0, 10, 0, MOVING), (0, 20, 0, MOVING)],
        [(0, 10, 0, 0.9), (0, 60, 0, 0.7), (0, 20, 0, 0.5)],
    )
    score = whole(labels, boxes, points=[100, 3])
    assert score.labels == (1, 2)
    assert (score.precision, score.recall) == pytest.approx((2 / 3, 1.0))
    assert score.cutoff == 0.0


def test_range_takes_in_the_height() -> None:
    """As Waymo's does: 29.9 m ahead and 5 m up is 30.3 m away."""
    case = material([(0, 29.9, 0, MOVING)], [(0, 29.9, 0, 0.9)])
    raised = replace(case.labels, center_m=case.labels.center_m + [0, 0, 5.0])
    scores = detection_scores(replace(case, labels=raised), ONE_IOU, moving_only=True)
    assert [score.labels[1] for score in scores] == [1, 0, 1, 0]


def test_the_analysis_of_errors_has_an_iou_of_its_own() -> None:
    """A box with IoU 0.6 is right from 0.4 on, whatever IoU the average precision is asked at."""
    case = material([(0, 10, 0, MOVING)], [(0, 11, 0, 0.9)])
    best = diagnosis(case, replace(SETTINGS, iou=(0.7,), right_iou=0.4, top_share=1.0), moving_only=True).best
    assert best is not None
    assert (best.right, best.localisation) == (1, 0)
    best = diagnosis(case, replace(SETTINGS, iou=(0.4,), right_iou=0.7, top_share=1.0), moving_only=True).best
    assert best is not None
    assert (best.right, best.localisation) == (0, 1)


def test_one_score_for_each_iou() -> None:
    case = material([(0, 10, 0, MOVING)], [(0, 11, 0, 0.9)])
    scores = detection_scores(case, replace(SETTINGS, iou=(0.4, 0.5, 0.7)), moving_only=True)
    assert {score.iou: score.recall for score in scores if score.objects == "all"} == {
        0.4: 1.0,
        0.5: 1.0,
        0.7: 0.0,
    }


def test_why_boxes_are_wrong() -> None:
    labels = [(frame, 10.0, 0.0, MOVING) for frame in range(8)]
    boxes = [(0, 10, 0, 0.9), (1, 12, 0, 0.8), (2, 10, 20, 0.7), (3, 13.5, 0, 0.6), (4, 10, 0, 0.5)]
    best = diagnosis(material(labels, boxes), SETTINGS, moving_only=True).best
    assert best is not None
    # Half as many boxes as labels: IoU 1, 1/3, 0, and 0.5 / 7.5, which is no overlap to speak of.
    assert (best.labels, best.right, best.localisation, best.background) == (8, 1, 1, 2)


def test_boxes_on_standing_labels_are_neither_right_nor_wrong() -> None:
    labels = [(0, 10, 0, MOVING), (1, 10, 0, MOVING), (0, 30, 0, STANDING), (1, 30, 0, STANDING)]
    boxes = [(0, 30, 0, 0.9), (1, 33, 0, 0.8), (0, 10, 0, 0.2)]
    found = diagnosis(material(labels, boxes), SETTINGS, moving_only=True)
    assert found.best is not None
    assert (found.best.labels, found.best.right, found.best.localisation, found.best.background) == (
        2,
        1,
        0,
        0,
    )
    everything = diagnosis(material(labels, boxes), SETTINGS, moving_only=False).best
    assert everything is not None
    assert (everything.labels, everything.right, everything.localisation) == (4, 1, 1)


def test_a_match_with_a_standing_label_is_not_right_where_only_moving_ones_count() -> None:
    case = material([(0, 10, 0, MOVING), (0, 30, 0, STANDING)], [(0, 30, 0, 0.9)])
    all_looked_at = replace(SETTINGS, top_share=1.0)
    best = diagnosis(case, all_looked_at, moving_only=True).best
    assert best is not None
    assert (best.labels, best.right, best.localisation, best.background) == (1, 0, 0, 0)


def test_which_labels_are_missed() -> None:
    labels = [(0, 10, 0, 2.0), (0, 40, 0, 5.0), (0, 60, 0, 20.0)]
    case = material(labels, [(0, 40, 0, 0.01)], points=[3, 50, 200], in_view=[True, True, False])
    groups = {
        (of.split, of.group): (of.labels, of.missed)
        for of in diagnosis(case, SETTINGS, moving_only=True).misses
        if of.labels
    }
    assert groups == {
        ("points", "below 6 points"): (1, 1),
        ("points", "[20, 100) points"): (1, 0),
        ("points", "from 100 points"): (1, 1),
        ("range", "below 30 m"): (1, 1),
        ("range", "[30, 50) m"): (1, 0),
        ("range", "from 50 m"): (1, 1),
        ("view", "in view"): (2, 1),
        ("view", "out of view"): (1, 1),
        ("speed", "[1, 3) m/s"): (1, 1),
        ("speed", "[3, 10) m/s"): (1, 0),
        ("speed", "from 10 m/s"): (1, 1),
    }


def test_tracks_count_misses_false_boxes_and_changes_of_identity() -> None:
    case = material(
        [(frame, 10.0, 0.0, MOVING) for frame in range(10)],
        [(frame, 10.0, 0.0, 0.9) for frame in range(8)] + [(0, 50.0, 0.0, 0.9)],
    )
    one = replace(case.labels, object_id=["a"] * 10)
    two = replace(case.predictions, object_id=[1] * 5 + [2] * 3 + [3])
    for score in track_scores(replace(case, labels=one, predictions=two), ONE_IOU, moving_only=True):
        assert score.labels == 10
        assert (score.miss, score.false_positive, score.mismatch) == pytest.approx((0.2, 0.1, 0.1))
        assert score.mota == pytest.approx(0.6)
        assert score.motp == 0.0


PLACES = st.tuples(
    st.integers(0, 2), st.sampled_from([0.0, 1.0, 10.0, 29.0, 60.0, 1e6]), st.sampled_from([0.0, 1.0])
)
# Cars as they are, boxes without any size, and boxes of 1e6 m.
SCALES = st.sampled_from([1.0, 0.0, 2.5e5])
LABELS = st.lists(st.tuples(PLACES, st.sampled_from([0.0, 1.0, 30.0])), max_size=8)
BOXES = st.lists(st.tuples(PLACES, st.sampled_from([0.0, 0.5, 1.0])), max_size=8)


def scaled(boxes, scale):
    """The boxes in another size."""
    return replace(boxes, size_lwh_m=boxes.size_lwh_m * scale)


@pytest.mark.parametrize("part", ["center_m", "size_lwh_m", "heading_rad"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_box_that_is_no_box_is_refused(wrong: float, part: str) -> None:
    case = material([(0, 10, 0, MOVING)], [(0, 10, 0, 0.9)])
    for boxes in (case.labels, case.predictions):
        with pytest.raises(BadInput, match=r"segment drive, frame 0\) has a box that is not finite"):
            replace(boxes, **{part: getattr(boxes, part) + wrong})


@settings(max_examples=60)
@given(LABELS, BOXES, st.booleans(), SCALES)
def test_nothing_crashes_and_all_shares_are_shares(labels, boxes, moving_only, scale) -> None:
    case = material([(*place, last) for place, last in labels], [(*place, last) for place, last in boxes])
    case = replace(case, labels=scaled(case.labels, scale), predictions=scaled(case.predictions, scale))
    for score in detection_scores(case, SETTINGS, moving_only=moving_only):
        values = [
            *score.ap,
            *score.aph,
            score.precision,
            score.recall,
            *score.curve_precision,
            *score.curve_recall,
        ]
        assert all(0 <= value <= 1 for value in values)
        assert score.labels[0] <= score.labels[1] <= len(labels)
    for track in track_scores(case, SETTINGS, moving_only=moving_only):
        assert 0 <= track.mota <= 1
        assert 0 <= track.motp <= 1
    found = diagnosis(case, SETTINGS, moving_only=moving_only)
    asked = sum(not moving_only or last >= 1.0 for _, last in labels)
    for split in ("points", "range", "view", "speed"):
        assert sum(of.labels for of in found.misses if of.split == split) == asked
    assert all(0 <= of.missed <= of.labels for of in found.misses)


@settings(max_examples=30)
@given(LABELS, BOXES)
def test_where_all_labels_move_both_modes_agree(labels, boxes) -> None:
    case = material([(*place, MOVING) for place, _ in labels], [(*place, last) for place, last in boxes])
    for moving, every in zip(
        *(detection_scores(case, SETTINGS, moving_only=mode) for mode in (True, False)), strict=True
    ):
        assert moving == every
    moving, every = (diagnosis(case, SETTINGS, moving_only=mode) for mode in (True, False))
    assert moving == every
