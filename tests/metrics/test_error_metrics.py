"""Why false positives are false, and which labels are missed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from upvl_cli.errors import BadInput
from upvl_cli.metrics.error_analysis import (
    MissedLabels,
    Outcome,
    TopOutcomes,
    classify_predictions,
    count_missed_labels,
    count_top_outcomes,
)
from upvl_cli.metrics.waymo.detection import match_boxes
from upvl_cli.metrics.waymo.inputs import Predictions, Truth

VEHICLE, PEDESTRIAN, UNKNOWN = 1, 2, 0


def truth(rows: list[tuple[int, float, int]]) -> Truth:
    """Labels of a metre's cube each: frame, x, type."""
    n = len(rows)
    frame, x, kind = np.array(rows, dtype=float).reshape(-1, 3).T
    return Truth.from_rows(
        np.column_stack([x, np.zeros((n, 2)), np.ones((n, 3)), np.zeros(n)]),
        sequence=["drive"] * n,
        frame=frame,
        type=kind,
        level=np.ones(n),
        velocity_mps=np.zeros((n, 2)),
        object_id=[str(i) for i in range(n)],
    )


def predictions(
    rows: list[tuple[int, float, int, float]], unlabelled: list[bool] | None = None
) -> Predictions:
    """Boxes of a metre's cube each: frame, x, type, score."""
    n = len(rows)
    frame, x, kind, score = np.array(rows, dtype=float).reshape(-1, 4).T
    return Predictions.from_rows(
        np.column_stack([x, np.zeros((n, 2)), np.ones((n, 3)), np.zeros(n)]),
        sequence=["drive"] * n,
        frame=frame,
        type=kind,
        score=score,
        velocity_mps=np.zeros((n, 2)),
        object_id=[str(i) for i in range(n)],
        unlabelled=unlabelled if unlabelled is not None else [False] * n,
    )


def found_by(labels: Truth, boxes: Predictions) -> np.ndarray:
    thresholds = [0.4] * 5
    return match_boxes(labels, boxes, iou_thresholds=thresholds, score_cutoff=0.0, matcher="hungarian").truth


# Moved by d, two cubes of a metre have an IoU of (1 - d) / (1 + d): 0.6 gives 0.25, 0.9 gives 0.053.
LABELS = truth([(0, 0, VEHICLE), (0, 10, PEDESTRIAN), (0, 20, UNKNOWN), (1, 30, VEHICLE)])
CASES = [
    ("on its label", (0, 0.1, VEHICLE, 1.0), Outcome.RIGHT),
    ("misplaced", (0, 0.6, VEHICLE, 0.9), Outcome.LOCALISATION),
    ("hardly touching", (0, 0.9, VEHICLE, 0.9), Outcome.BACKGROUND),
    ("nothing there", (0, 50, VEHICLE, 0.9), Outcome.BACKGROUND),
    ("the label of another frame", (1, 0, VEHICLE, 0.9), Outcome.BACKGROUND),
    ("a walker called a car", (0, 10, VEHICLE, 0.9), Outcome.OTHER_CLASS),
    ("a misplaced walker called a car", (0, 10.6, VEHICLE, 0.9), Outcome.OTHER_CLASS),
    ("a thing of no type called a car", (0, 20, VEHICLE, 0.9), Outcome.OTHER_CLASS),
]


@pytest.mark.parametrize(("row", "expected"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_one_prediction(row: tuple[int, float, int, float], expected: Outcome) -> None:
    boxes = predictions([row])
    assert classify_predictions(
        LABELS, boxes, found_by(LABELS, boxes) >= 0, min_overlap_iou=0.1
    ).tolist() == [expected]


def test_a_second_box_for_a_label_is_a_localisation_error() -> None:
    boxes = predictions([(0, 0.2, VEHICLE, 1.0), (0, 0, VEHICLE, 0.5)])
    result = classify_predictions(LABELS, boxes, found_by(LABELS, boxes) >= 0, min_overlap_iou=0.1)
    assert result.tolist() == [Outcome.LOCALISATION, Outcome.RIGHT]


def test_the_own_type_comes_before_others() -> None:
    labels = truth([(0, 0, VEHICLE), (0, 0.8, PEDESTRIAN)])
    boxes = predictions([(0, 0.6, VEHICLE, 1.0)])
    assert classify_predictions(labels, boxes, np.array([False]), min_overlap_iou=0.1).tolist() == [
        Outcome.LOCALISATION
    ]


def test_only_the_best_half_is_looked_at() -> None:
    labels = truth([(0, 10.0 * i, VEHICLE) for i in range(6)] + [(0, 100, PEDESTRIAN)])
    rows = [
        (0, 50.0, VEHICLE, 0.1),  # right, but not among the best three
        (0, 0.0, VEHICLE, 0.9),
        (0, 70.0, VEHICLE, 0.8),
        (0, 10.6, VEHICLE, 0.7),
    ]
    boxes = predictions(rows)
    outcome = classify_predictions(labels, boxes, found_by(labels, boxes) >= 0, min_overlap_iou=0.1)
    assert count_top_outcomes(labels, boxes, outcome, top_share=0.5) == [
        TopOutcomes(VEHICLE, 6, right=1, localisation=1, other_class=0, background=1),
        TopOutcomes(PEDESTRIAN, 1, right=0, localisation=0, other_class=0, background=0),
    ]
    boxes = predictions(rows, unlabelled=[True, True, True, False])
    assert count_top_outcomes(labels, boxes, outcome, top_share=0.5)[0] == TopOutcomes(VEHICLE, 6, 2, 1, 0, 0)


def test_misses_by_hand() -> None:
    assert count_missed_labels(
        np.array([True, False, False, True, False]),
        points=[0, 5, 20, 100, -1],
        range_m=[10, 30, 29.9, 70, 80],
        in_view=[True, True, False, False, False],
        point_edges=[1, 20],
        range_edges_m=[30, 50],
    ) == [
        MissedLabels("points", "below 1 points", 1, 0),
        MissedLabels("points", "[1, 20) points", 1, 1),
        MissedLabels("points", "from 20 points", 2, 1),
        MissedLabels("points", "unknown", 1, 1),
        MissedLabels("range", "below 30 m", 2, 1),
        MissedLabels("range", "[30, 50) m", 1, 1),
        MissedLabels("range", "from 50 m", 2, 1),
        MissedLabels("view", "in view", 2, 1),
        MissedLabels("view", "out of view", 3, 2),
    ]


def test_empty() -> None:
    none, no_boxes = truth([]), predictions([])
    assert classify_predictions(none, no_boxes, np.zeros(0, dtype=bool), min_overlap_iou=0.1).tolist() == []
    assert count_top_outcomes(none, no_boxes, np.zeros(0, dtype=np.int64), top_share=0.5) == []
    some = predictions([(0, 0, VEHICLE, 1.0)])
    outcome = classify_predictions(none, some, np.array([False]), min_overlap_iou=0.1)
    assert outcome.tolist() == [Outcome.BACKGROUND]
    assert count_top_outcomes(none, some, outcome, top_share=0.5) == [TopOutcomes(VEHICLE, 0, 0, 0, 0, 0)]
    rows = count_missed_labels(
        np.zeros(0, dtype=bool), points=[], range_m=[], in_view=[], point_edges=[1], range_edges_m=[30]
    )
    assert {(row.labels, row.missed) for row in rows} == {(0, 0)}


BAD: list[tuple[dict[str, Any], str]] = [
    ({"point_edges": []}, "^edges of points must ascend, at least one"),
    ({"range_edges_m": [50, 30]}, "^edges of range must ascend"),
    ({"points": [1, 2]}, "^labels to split have arrays of different lengths"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_input_is_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    fine: dict[str, Any] = {
        "points": [1],
        "range_m": [1],
        "in_view": [True],
        "point_edges": [1],
        "range_edges_m": [30],
    }
    with pytest.raises(BadInput, match=message):
        count_missed_labels(np.array([True]), **fine | change)
