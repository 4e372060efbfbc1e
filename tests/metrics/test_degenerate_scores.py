"""No input crashes the scores or drives a value out of [0, 1]."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from streets import guesses, labels

from upvl_cli.metrics.waymo.breakdown import BREAKDOWNS, moving_objects
from upvl_cli.metrics.waymo.detection import detection, match_boxes
from upvl_cli.metrics.waymo.inputs import Predictions, Truth
from upvl_cli.metrics.waymo.official import Matcher
from upvl_cli.metrics.waymo.tracking import tracking

SPLITS = [*BREAKDOWNS.values(), moving_objects(min_speed_mps=1.0)]
CUTOFFS = np.array([0.0, 0.3, 0.7, 1.0], dtype=np.float32)
PLACES = st.sampled_from([0.0, 1.0, 1.5, 29.999, 30.0, -50.0, 1e6, -1e12])
SIZES = st.sampled_from([0.0, -1.0, 0.01, 0.011, 1.0, 2.0, 7.0, 1e6 - 1, 1e6, 1e12])
HEADINGS = st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi, 0.3, 1e6, -1e12])
BOXES = st.tuples(PLACES, PLACES, PLACES, SIZES, SIZES, SIZES, HEADINGS)
SPEEDS = st.sampled_from([0.0, 0.2, 1.0, 12.0, np.nan, np.inf])


@st.composite
def columns(draw: st.DrawFn) -> dict[str, Any]:
    """Columns that labels and predictions share."""
    pool = draw(st.lists(BOXES, min_size=1, max_size=3))  # few kinds of boxes: many identical ones
    n = draw(st.integers(0, 8))

    def some(values: st.SearchStrategy[Any]) -> list[Any]:
        return draw(st.lists(values, min_size=n, max_size=n))

    return {
        "boxes": some(st.sampled_from(pool)),
        "sequence": some(st.sampled_from(["s", "t"])),
        "frame": some(st.integers(0, 1)),
        "type": some(st.integers(0, 4)),
        "velocity_mps": np.reshape(some(st.tuples(SPEEDS, SPEEDS)), (n, 2)),
    }


@st.composite
def streets(draw: st.DrawFn) -> tuple[Truth, Predictions]:
    """Labels and predictions, some of the predictions copies of labels."""
    known, found = draw(columns()), draw(columns())
    n, m = len(known["boxes"]), len(found["boxes"])
    for i in range(min(n, m)):
        if draw(st.booleans()):
            for name in ("boxes", "sequence", "frame", "type"):
                found[name][i] = known[name][i]
    truth = labels(**known, level=draw(st.lists(st.integers(0, 2), min_size=n, max_size=n)))
    score = st.sampled_from([-1.0, 0.0, 0.3, 0.5, 1.0, 2.0])
    ids = st.sampled_from(["p", "q", "r"])
    return truth, guesses(
        **found,
        score=draw(st.lists(score, min_size=m, max_size=m)),
        object_id=np.array(draw(st.lists(ids, min_size=m, max_size=m)), dtype=str),
        unlabelled=draw(st.lists(st.booleans(), min_size=m, max_size=m)),
    )


@settings(max_examples=100)
@given(streets(), st.sampled_from(["hungarian", "score_first"]), st.sampled_from([1e-6, 0.5, 1.0]))
def test_values_stay_in_range(street: tuple[Truth, Predictions], matcher: Matcher, threshold: float) -> None:
    rule = {
        "iou_thresholds": [threshold] * 5,
        "breakdowns": SPLITS,
        "score_cutoffs": CUTOFFS,
        "matcher": matcher,
    }
    for result in detection(*street, **rule):
        assert 0 <= result.aph <= result.ap <= 1
        assert (np.minimum.reduce([result.tp, result.fp, result.fn]) >= 0).all()
        for values in (result.precision, result.precision_ha, result.recall):
            assert ((values >= 0) & (values <= 1)).all()
    for tracked in tracking(*street, **rule):
        values = [tracked.mota, tracked.motp, tracked.miss, tracked.false_positive, tracked.mismatch]
        assert 0 <= min(values) <= max(values) <= 1
        assert min(np.min(v) for v in vars(tracked.counts).values()) >= 0
        assert (tracked.counts.match <= tracked.counts.truth).all()


@settings(max_examples=60)
@given(streets())
def test_box_matches_are_one_to_one(street: tuple[Truth, Predictions]) -> None:
    truth, predictions = street
    matched = match_boxes(*street, iou_thresholds=[0.5] * 5, score_cutoff=0.2, matcher="hungarian")
    rows = np.flatnonzero(matched.truth >= 0)
    assert (matched.prediction[matched.truth[rows]] == rows).all()
    assert (matched.prediction >= 0).sum() == len(rows)
    assert (matched.iou[rows] >= 0.5).all()
    assert (matched.truth[predictions.score < 0.2] == -2).all()
    assert (truth.frame[matched.truth[rows]] == predictions.frame[rows]).all()
