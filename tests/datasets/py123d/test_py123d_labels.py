"""Boxes of py123d logs: axes, tracks, classes, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("py123d.api", reason="needs the extra py123d")

from py123d.datatypes import DefaultBoxDetectionLabel
from py123d.geometry import PoseSE3, Vector3D
from py123d.parser.registry import AV2SensorBoxDetectionLabel as Av2

from datasets.contract import assert_one_line, check_labels
from datasets.py123d import py123d_log as tiny
from datasets.py123d.py123d_log import CAR_SIZE_LWH_M, CAR_SPEED_MPS, LOG, write_log
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.labels import LabelSource
from upvl_cli.datasets.py123d.dataset import Py123dLogs
from upvl_cli.errors import BadInput


def labels_of(root: Path) -> LabelSource:
    return label_source("py123d", root, Py123dLogs(root))


def labels_with(root: Path, make: Any) -> LabelSource:
    """A log of two iterations with the boxes that a function of the step gives; no row where that is None."""
    steps = []
    for step in range(2):
        found = make(step)
        steps.append([tiny.ego_state(step), tiny.sweep(step)])
        if found is not None:
            steps[-1].append(tiny.boxes(step, found))
    return labels_of(write_log(root, steps))


def test_boxes_are_in_the_axes_of_their_frame(tmp_path: Path) -> None:
    root = write_log(tmp_path)
    source = labels_of(root)
    check_labels(source, Py123dLogs(root).open(LOG))
    labels = source.labels(LOG)
    assert labels.frame.tolist() == source.frames(LOG).tolist() == [0, 1, 2, 3]
    assert set(labels.object_id.tolist()) == {"car-1"} and set(labels.class_name.tolist()) == {
        "REGULAR_VEHICLE"
    }
    assert labels.type.tolist() == [1] * 4 and labels.num_points.tolist() == [7] * 4
    np.testing.assert_array_equal(labels.size_lwh_m, [CAR_SIZE_LWH_M] * 4)
    for row in range(4):
        ego, car = tiny.pose(row), tiny.car(row)
        expected = (car.array[:3] - ego.array[:3]) @ ego.rotation_matrix
        np.testing.assert_allclose(labels.center_m[row], expected, atol=1e-6)
        np.testing.assert_allclose(labels.heading_rad[row], 0.3 - 0.02 * row, atol=1e-9)
        turned = np.array([CAR_SPEED_MPS, 0, 0]) @ ego.rotation_matrix
        np.testing.assert_allclose(labels.velocity_mps[row], turned, atol=1e-9)


def test_what_a_log_does_not_say_is_measured(tmp_path: Path) -> None:
    """Velocities by the track, points by the sweep."""
    wall = PoseSE3(2.0, 9.0, 2.0, 1, 0, 0, 0)

    def make(step: int) -> Any:
        ego = tiny.pose(step).transformation_matrix
        place = PoseSE3.from_transformation_matrix(ego @ wall.transformation_matrix)
        return [
            tiny.box(tiny.car(step), num_lidar_points=None),
            tiny.box(place, "wall", num_lidar_points=None),
        ]

    labels = labels_with(tmp_path, make).labels(LOG)
    drives = labels[labels.object_id == "car-1"]
    np.testing.assert_allclose(drives.velocity_mps[0], [CAR_SPEED_MPS, 0, 0], atol=1e-4)
    points = tiny.ego_points().astype(float)
    inside = (np.abs(points - [2, 9, 2]) <= np.array(CAR_SIZE_LWH_M) / 2).all(axis=1)
    assert inside.sum() > 3
    assert labels[labels.object_id == "wall"].num_points.tolist() == [inside.sum()] * 2


CLASSES = [
    (Av2.PEDESTRIAN, 2),
    (Av2.BICYCLIST, 4),
    (Av2.OFFICIAL_SIGNALER, 2),  # by the class that the library gives it: PERSON
    (Av2.STOP_SIGN, 3),
    (Av2.BOLLARD, 0),
    (Av2.DOG, 0),
]


@pytest.mark.parametrize(("label", "number"), CLASSES, ids=[case[0].name for case in CLASSES])
def test_types(label: Any, number: int, tmp_path: Path) -> None:
    labels = labels_with(tmp_path, lambda step: [tiny.box(tiny.car(step), label=label)]).labels(LOG)
    assert labels.class_name.tolist() == [label.name] * 2
    assert labels.type.tolist() == [number] * 2


def test_frames_without_boxes_and_frames_without_labels(tmp_path: Path) -> None:
    source = labels_with(tmp_path, lambda step: None if step else [])
    assert source.frames(LOG).tolist() == [0] and len(source.labels(LOG)) == 0


def test_the_recording_car_is_no_label(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(tiny.BOXES, "_box_detection_label_class", DefaultBoxDetectionLabel)
    kinds = [DefaultBoxDetectionLabel.EGO, DefaultBoxDetectionLabel.PERSON]
    make = [tiny.box(tiny.car(0), f"track-{kind.name}", kind) for kind in kinds]
    labels = labels_with(tmp_path, lambda step: make).labels(LOG)
    assert set(labels.object_id.tolist()) == {"track-PERSON"} and set(labels.type.tolist()) == {2}


def test_a_log_without_labels(tmp_path: Path) -> None:
    source = labels_of(write_log(tmp_path, [[tiny.ego_state(0), tiny.sweep(0)]]))
    for read in (source.labels, source.frames):
        with pytest.raises(BadInput, match=r"has no labels .* expected .*box_detections_se3\.arrow"):
            read(LOG)


def test_labels_need_poses(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="has no ego_state_se3.arrow to place them"):
        labels_of(write_log(tmp_path, [[tiny.sweep(0), tiny.boxes(0)]])).labels(LOG)


def flat_box(step: int) -> Any:
    found = tiny.box(tiny.car(step))
    found._bounding_box_se3._array[8] = 0
    return [found]


WRONG = [
    ("a track twice", lambda step: [tiny.box(tiny.car(step))] * 2, "two boxes of track 'car-1'"),
    ("no width", flat_box, "a box of [4.0, 0.0, 1.5] m"),
    (
        "a box at no place",
        lambda step: [tiny.box(PoseSE3(np.nan, 0, 0, 1, 0, 0, 0))],
        "iteration 0: box moves by nan m",
    ),
    ("a box far away", lambda step: [tiny.box(PoseSE3(0, 0, 0, 1, 0, 0, 0))], "more than 10000 m away"),
    (
        "a speed of another unit",
        lambda step: [tiny.box(tiny.car(step), velocity=Vector3D(8000.0, 0, 0))],
        "check the unit",
    ),
]


@pytest.mark.parametrize(("make", "message"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG])
def test_wrong_boxes_are_one_clear_line(make: Any, message: str, tmp_path: Path) -> None:
    source = labels_with(tmp_path, make)
    with pytest.raises(BadInput) as failure:
        source.labels(LOG)
    assert message in str(failure.value)
    assert "box_detections_se3.arrow, iteration 0" in str(failure.value)
    assert_one_line(failure.value)
