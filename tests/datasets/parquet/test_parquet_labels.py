"""Human boxes of the open door."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import open_door
from datasets.contract import assert_one_line, check_labels
from open_door import FRAMES, SEGMENT, write_open_door, write_table
from upvl_cli.datasets.label_registry import label_source
from upvl_cli.datasets.labels import LabelSource
from upvl_cli.datasets.parquet.dataset import ParquetDrives
from upvl_cli.errors import BadInput


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_open_door(tmp_path / "drives")


def labels_of(root: Path) -> LabelSource:
    return label_source("parquet", root, ParquetDrives(root))


def write_labels(root: Path, metadata: dict[str, str] | None = None, **changes: Any) -> None:
    write_table(root / f"labels/{SEGMENT}.parquet", open_door.label_columns(**changes), metadata)


def test_the_contract_of_labels(root: Path) -> None:
    check_labels(labels_of(root), ParquetDrives(root).open(SEGMENT))


def test_boxes_with_points_and_velocities(root: Path) -> None:
    labels = labels_of(root).labels(SEGMENT)
    assert labels.frame.tolist() == list(FRAMES)
    assert set(labels.type.tolist()) == {1} and set(labels.class_name.tolist()) == {"Car"}
    assert (labels.num_points >= 70).all()
    np.testing.assert_allclose(labels.velocity_mps, 0, atol=1e-6)  # the car stands, though the ego drives
    assert np.ptp(labels.center_m[:, 0]) > 1


def test_given_velocities_are_taken(root: Path) -> None:
    write_labels(root, velocity_x_mps=[3.0, np.nan, 3.0, 3.0], velocity_y_mps=[1.0] * 4)
    velocity = labels_of(root).labels(SEGMENT).velocity_mps
    assert velocity[0].tolist() == [3, 1, 0]
    np.testing.assert_allclose(velocity[1], 0, atol=1e-6)


def test_without_poses_there_is_no_velocity(root: Path) -> None:
    write_table(root / f"points/{SEGMENT}.parquet", open_door.point_columns(world_from_ego=None))
    assert np.isnan(labels_of(root).labels(SEGMENT).velocity_mps).all()


def test_frames_without_a_box_are_not_labelled(root: Path) -> None:
    write_labels(root, frame=[3, 4, 6, 99])
    source = labels_of(root)
    assert source.frames(SEGMENT).tolist() == [3, 4, 6]
    assert source.labels(SEGMENT).frame.tolist() == [3, 4, 6]


def test_the_region_that_was_labelled(root: Path) -> None:
    places = np.array([[10.0, 0, 0], [30.0, 0, 0], [-10.0, 0, 0]])
    assert labels_of(root).covers(SEGMENT, places).tolist() == [True, True, True]
    write_labels(root, {"region_range_m": "20"})
    assert labels_of(root).covers(SEGMENT, places).tolist() == [True, False, True]
    write_labels(root, {"region_range_m": "20", "region_camera": "front"})
    assert labels_of(root).covers(SEGMENT, places).tolist() == [True, False, False]


def test_a_drive_without_labels_says_so(root: Path) -> None:
    (root / f"labels/{SEGMENT}.parquet").unlink()
    for ask in (labels_of(root).labels, labels_of(root).frames):
        with pytest.raises(BadInput, match="has no labels; expected .*labels/town-1.parquet"):
            ask(SEGMENT)


WRONG = [
    ({"class": None}, {}, "lacks the column class"),
    ({"length_m": [0.0] * 4}, {}, "row 0 is no box"),
    ({"center_x_m": [np.nan] * 4}, {}, "row 0 is no box"),
    ({"heading_rad": ["north"] * 4}, {}, "is of type string"),
    ({"frame": [3, 3, 6, 7]}, {}, "two boxes of track 'car-1' in frame 3"),
    ({"velocity_x_mps": [1.0] * 4}, {}, "velocity_x_mps alone"),
    ({"velocity_x_mps": [1e6] * 4, "velocity_y_mps": [0.0] * 4}, {}, "check their unit"),
    ({}, {"region_range_m": "far"}, "region_range_m is 'far'"),
    ({}, {"region_camera": "rear"}, "region_camera is 'rear', but the drive's cameras are front"),
]


@pytest.mark.parametrize(("changes", "metadata", "message"), WRONG, ids=[case[2] for case in WRONG])
def test_wrong_labels_are_one_clear_line(
    changes: dict[str, Any], metadata: dict[str, str], message: str, root: Path
) -> None:
    write_labels(root, metadata, **changes)
    source = labels_of(root)
    with pytest.raises(BadInput) as failure:
        source.covers(SEGMENT, source.labels(SEGMENT).center_m)
    assert message in str(failure.value)
    assert_one_line(failure.value)
