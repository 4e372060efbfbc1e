"""What a person changed is found by construction: boxes that were moved, renamed, added, deleted and numbered anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from upvl_cli.export.corrections import Corrections, corrected
from upvl_cli.export.differences import differences
from upvl_cli.export.drive import ExportBoxes
from upvl_cli.types import concat

_BOXES = labelled_drive(frames=3).boxes
LABELS = replace(_BOXES, track_id=(_BOXES.track_id - 7) // 10)  # frames 3, 5 and 7 with the tracks 0 to 4
ALL = np.ones(len(LABELS), dtype=np.bool_)


def edited(**columns: np.ndarray) -> ExportBoxes:
    return replace(LABELS, **columns)


def at(frame: int, track: int) -> int:
    return int(np.flatnonzero((LABELS.frame == frame) & (LABELS.track_id == track))[0])


def changes(found: Corrections) -> list[tuple[int, int, str]]:
    return list(zip(found.frame.tolist(), found.track_id.tolist(), found.change.tolist(), strict=True))


def test_untouched_labels_are_kept() -> None:
    noise = np.full((len(LABELS), 3), 1e-3)
    found = differences(LABELS, edited(center_m=LABELS.center_m + noise), ALL)
    assert (len(found.corrections), found.kept) == (0, 15)


def test_what_a_tool_rounds_is_kept_and_what_is_moved_is_not() -> None:
    """Two decimals, as datumaro keeps them; half a step in the heading is 0.3 degrees."""
    rounded = LABELS.to_rows().round(2)
    back = edited(center_m=rounded[:, :3], size_lwh_m=rounded[:, 3:6], heading_rad=rounded[:, 6])
    assert differences(LABELS, back, ALL).kept < 15
    assert differences(LABELS, back, ALL, tool_step=0.01).kept == 15
    back.center_m[at(5, 2)] += 0.02
    assert changes(differences(LABELS, back, ALL, tool_step=0.01).corrections) == [(5, 2, "moved")]


@pytest.mark.parametrize(
    ("column", "value"),
    [("center_m", [0.02, 0.0, 0.0]), ("size_lwh_m", [0.0, 0.02, 0.0]), ("heading_rad", 0.01)],
    ids=["place", "size", "heading"],
)
def test_a_moved_box_replaces_the_label_of_its_track(column: str, value: object) -> None:
    values = getattr(LABELS, column).copy()
    values[at(5, 2)] += value
    found = differences(LABELS, edited(**{column: values}), ALL)
    assert changes(found.corrections) == [(5, 2, "moved")]
    assert found.kept == 14
    boxes, by_hand = corrected(LABELS, found.corrections)
    np.testing.assert_array_equal(getattr(boxes, column), values)
    assert [boxes.track_id[by_hand].tolist(), boxes.frame[by_hand].tolist()] == [[2], [5]]


def test_a_box_with_another_class_alone_is_renamed() -> None:
    names = LABELS.class_name.copy()
    names[at(3, 0)] = "fire truck"
    found = differences(LABELS, edited(class_name=names), ALL)
    assert changes(found.corrections) == [(3, 0, "renamed")]
    assert found.corrections.class_name.tolist() == ["fire truck"]


def test_new_and_deleted_boxes() -> None:
    added = replace(LABELS[:1], center_m=[[50.0, 9, 1]], track_id=[77])
    back = concat([LABELS[np.arange(15) != at(7, 4)], added], ExportBoxes)
    found = differences(LABELS, back, ALL)
    assert changes(found.corrections) == [(3, 77, "new"), (7, 4, "deleted")]
    boxes, _ = corrected(LABELS, found.corrections)
    assert len(boxes) == 15
    assert not ((boxes.frame == 7) & (boxes.track_id == 4)).any()


def test_labels_that_did_not_go_out_are_not_deleted() -> None:
    went_out = LABELS.track_id == 1
    found = differences(LABELS, LABELS[went_out], went_out)
    assert (len(found.corrections), found.kept) == (0, 3)


def test_ids_that_a_tool_gave_anew_are_those_of_the_nearest_labels() -> None:
    back = edited(track_id=4 - LABELS.track_id)  # the tool counts backwards: each id is another object's
    found = differences(LABELS, back, ALL)
    assert (len(found.corrections), found.kept) == (0, 15)


def test_a_gap_that_is_filled_belongs_to_its_track() -> None:
    gap = at(5, 3)
    labels = LABELS[np.arange(15) != gap]
    found = differences(labels, LABELS, np.ones(14, dtype=np.bool_))
    assert changes(found.corrections) == [(5, 3, "new")]


def test_a_new_object_never_takes_the_track_of_another() -> None:
    went_out = LABELS.track_id != 0
    added = replace(LABELS[:1], center_m=[[80.0, 40, 1]], track_id=[0])  # the person never saw track 0
    found = differences(LABELS, concat([LABELS[went_out], added], ExportBoxes), went_out)
    assert changes(found.corrections) == [(3, 5, "new")]
