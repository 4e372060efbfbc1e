"""From boxes and votes to the table that users take, read as any Parquet reader does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from memory_inputs import SEGMENT, MemoryDrive, MemoryInputs, amodal_row, boxes2d_row, classify_row, looks_row

from upvl_cli.perception.labels.config import LookVoteConfig, PictureScoreConfig, SizeConfig
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS, Basis
from upvl_cli.perception.visual.views import NO_VIEW, SEEN
from upvl_cli.pipeline.tables import write
from upvl_cli.stages import classify, labels, nms, pool_features
from upvl_cli.stages.picture_rows import ExtractVlRow, MatchBoxes2dRow, PcaRow
from upvl_cli.stages.rows import AmodalRow, LabelRow, MaskRow, OdometryRow
from upvl_cli.types import Boxes, Boxes2d, Camera

STREET = Boxes.from_rows(
    np.array(
        [
            [10.0, 2, 0.8, 4, 2, 1.6, 0.5],
            [20, -3, 0.9, 0.6, 0.6, 1.8, 0],
            [5, 8, 1, 1, 1, 2, 0],
            [30, 0, 1, 4, 2, 2, 0],
        ]
    )
)
VELOCITY_MPS = np.array([[3.0, 4.0, 0], [0.6, -0.8, 0], [0, 0.99, 5.0], [0, 0, 0]])


@pytest.fixture
def table(tmp_path: Path) -> pa.Table:
    """The table of three frames; the middle one is empty, and classes stand in another order than boxes."""
    boxes = [
        amodal_row(3, STREET, [7, 4, 9, 5], velocity_mps=VELOCITY_MPS),
        amodal_row(4, STREET[:0], []),
        amodal_row(6, STREET[:1], [4]),
    ]
    classes = [
        classify_row(3, [(4, 2, "person", 0.75), (5, 0, "", 0.0), (9, 0, "pole", 0.5), (7, 1, "bus", 1.0)]),
        classify_row(4, []),
        classify_row(6, [(4, 2, "person", 0.75)], look="walker", agree=False),
    ]
    shown = [
        MatchBoxes2dRow(
            SEGMENT, row.frame, row.track_id, np.zeros(len(row.track_id), np.int8), np.full(len(row.track_id), 0.5),
            np.full(len(row.track_id), "car"), np.ones(len(row.track_id)), np.full(len(row.track_id), "bus"),
            np.full(len(row.track_id), 0.75), np.ones(len(row.track_id)),
        )
        for row in boxes
    ]  # fmt: skip
    inputs = MemoryInputs({"nms": boxes, "classify": classes, "match-boxes2d": shown})
    path = tmp_path / "out" / "labels" / f"{SEGMENT}.parquet"
    rows = labels.run(inputs, labels.LabelsConfig(moving_mps=1.0))
    write(path, LabelRow, rows, stamp="{}", counts={})
    assert inputs.counts == {"labels": 5}
    return pq.read_table(path)


def test_a_label_is_one_row_with_a_column_for_each_value(table: pa.Table) -> None:
    assert table.num_rows == 5
    assert table.column_names == [
        "segment", "frame", "time_ns",
        "center_x_m", "center_y_m", "center_z_m", "length_m", "width_m", "height_m", "heading_rad",
        "velocity_x_mps", "velocity_y_mps", "velocity_z_mps",
        "num_points", "score", "track_id", "background_share", "num_frames_seen",
        "objectness", "sides_seen", "residual_m",
        "class", "word", "class_share", "is_moving",
        "num_looks", "look_word_1", "look_word_2", "look_word_3",
        "look_share_1", "look_share_2", "look_share_3", "words_agree", "iou_2d", "box_word", "box_share",
    ]  # fmt: skip
    assert not [
        name
        for name, kind in zip(table.schema.names, table.schema.types, strict=True)
        if pa.types.is_nested(kind)
    ]
    first = table.slice(0, 1).to_pylist()[0]
    expected = {"segment": SEGMENT, "frame": 3, "time_ns": 3 * 10**8, "center_x_m": 10.0, "center_y_m": 2.0}
    expected |= {"length_m": 4.0, "width_m": 2.0, "height_m": 1.6, "heading_rad": 0.5, "velocity_y_mps": 4.0}
    assert {name: first[name] for name in expected} == expected
    assert table["frame"].to_pylist() == [3, 3, 3, 3, 6]


def test_each_column_says_its_meaning_unit_and_axes(table: pa.Table) -> None:
    metadata = {field.name: field.metadata for field in table.schema}
    assert all(each[b"meaning"] for each in metadata.values())
    assert metadata["center_x_m"][b"unit"] == b"m"
    assert metadata["center_x_m"][b"axes"] == b"ego"
    assert metadata["velocity_x_mps"][b"unit"] == b"m/s"
    assert metadata["heading_rad"][b"unit"] == b"rad"
    assert metadata["time_ns"][b"unit"] == b"ns"


def test_the_class_is_that_of_the_track(table: pa.Table) -> None:
    assert table["class"].to_pylist() == ["vehicle", "pedestrian", "other", "unknown", "pedestrian"]
    assert table["word"].to_pylist() == ["bus", "person", "pole", "", "person"]
    assert table["class_share"].to_pylist() == [1.0, 0.75, 0.5, 0.0, 0.75]


def test_what_looks_name_stands_beside_the_class(table: pa.Table) -> None:
    assert table["look_word_1"].to_pylist() == ["", "", "", "", "walker"]
    assert table["look_share_1"].to_pylist() == [0, 0, 0, 0, 0.5]
    assert table["num_looks"].to_pylist() == [0, 0, 0, 0, 1]
    assert table["words_agree"].to_pylist() == [True, True, True, True, False]


def test_a_label_moves_by_its_speed_over_the_ground(table: pa.Table) -> None:
    assert table["is_moving"].to_pylist() == [True, True, False, False, False]  # 5, 1, 0.99 and 0 m/s


PICTURE = PictureScoreConfig(min_weight=0.2, full_iou=0.5)


def nms_inputs(row: AmodalRow, shown: Boxes2d | None = None) -> MemoryInputs:
    """Inputs of `nms`: the boxes of a frame, and 2D boxes in the picture of a camera that looks ahead."""
    forward = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]])
    intrinsic = np.array([[100.0, 0, 99.5], [0, 100, 49.5], [0, 0, 1]])
    camera = Camera("front", 200, 100, intrinsic, np.zeros(5), forward)
    pose = OdometryRow(SEGMENT, 0, 0, np.eye(4), True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    pictures = boxes2d_row(0, shown, cameras=0 if shown is None else 1)
    tables = {"amodal": [row], "odometry": [pose], "boxes2d": [pictures]}
    return MemoryInputs(tables, MemoryDrive({}, (camera,)))


def test_nms_keeps_the_better_boxes_in_their_order_and_counts_the_others() -> None:
    rows = [
        [30.0, 0, 1, 4, 2, 2, 0],
        [10, 0, 1, 4, 2, 2, 0],
        [10.5, 0, 1, 4, 2, 2, 0],
        [20, 0, 1, 4, 2, 0.2, 0],
    ]
    rows += [[20, 0, 1, 4, 2, 2, 0], [50, 0, 1, 0.2, 0.2, 0.4, 0], [70, 0, 1, 20, 10, 4, 0]]
    boxes = Boxes.from_rows(np.array(rows))
    score = np.array([0.1, 0.3, 0.9, 0.8, 0.2, 0.8, 0.8])
    config = nms.NmsConfig(max_iou=0.2, min_objectness=0.0, size=SizeConfig(0.1, 200.0, 0.3), picture=PICTURE)
    # In one frame the worse of two tracks can have more points: the better track stays in all of them.
    row = amodal_row(0, boxes, [1, 2, 3, 4, 5, 6, 7], score=score[::-1], objectness=score)
    inputs = nms_inputs(row)
    (kept,) = nms.run(inputs, config)
    # The flat box is gone before it could suppress the one below it.
    assert kept.track_id.tolist() == [1, 3, 5]
    assert kept.objectness.tolist() == pytest.approx([0.1, 0.9, 0.2])
    assert inputs.counts == {
        "boxes dropped: too flat": 1,
        "boxes dropped: too small": 1,
        "boxes dropped: too large": 1,
        "boxes dropped: unlike a road user": 0,
        "boxes dropped: overlap a better one": 1,
        "boxes kept": 3,
    }


def test_what_is_unlike_a_road_user_is_dropped_before_it_suppresses_anything() -> None:
    rows = np.array([[0.0, 0, 1, 4, 2, 2, 0], [0.5, 0, 1, 4, 2, 2, 0], [9.0, 0, 1, 4, 2, 2, 0]])
    row = amodal_row(0, Boxes.from_rows(rows), [1, 2, 3], objectness=np.array([0.2, 0.04, 0.05]))
    inputs = nms_inputs(row)
    (kept,) = nms.run(
        inputs,
        nms.NmsConfig(max_iou=0.2, min_objectness=0.05, size=SizeConfig(0.1, 200.0, 0.3), picture=PICTURE),
    )
    assert kept.track_id.tolist() == [1, 3]
    assert inputs.counts["boxes dropped: unlike a road user"] == 1


def test_a_track_that_fits_no_2d_box_has_a_lower_score_and_gives_way() -> None:
    """The near face of a cube of 2 m whose centre is 11 m ahead is 20 px around (99.5, 49.5)."""
    cube = [11.0, 0, 1, 2, 2, 2, 0]
    rows = np.array([cube, [11.0, 0.9, 1, 2, 2, 2, 0], [-11.0, 0, 1, 2, 2, 2, 0], [11, 8, 1, 2, 2, 2, 0]])
    row = amodal_row(0, Boxes.from_rows(rows), [1, 2, 3, 4], objectness=np.array([0.5, 0.6, 0.5, 0.5]))
    shown = Boxes2d(np.array([[89.5, 39.5, 109.5, 59.5]]), np.array([0.9]), np.array(["car"]))
    config = nms.NmsConfig(0.2, 0.0, SizeConfig(0.1, 200.0, 0.3), PICTURE)
    (kept,) = nms.run(nms_inputs(row, shown), config)
    # The second one is 9 px off, IoU 11 / 29: the first one is the better now. The third is behind, the last not seen.
    assert kept.track_id.tolist() == [1, 3, 4]
    np.testing.assert_allclose(kept.score, row.score[[0, 2, 3]] * [1, 1, 0.2])
    (kept,) = nms.run(nms_inputs(row), config)  # without a detector
    assert kept.track_id.tolist() == [2, 3, 4]
    np.testing.assert_array_equal(kept.score, row.score[1:])


class TwoWords:
    """A model whose words lie along the axes."""

    def embed_text(self, words: list[str]) -> np.ndarray:
        return np.eye(COMPONENTS, dtype=np.float32)[: len(words)]


def drive_of_points(
    words: list[int],
    xyz_m: list[list[float]],
    background: list[int],
    looks: dict[int, np.ndarray] | None = None,
) -> MemoryInputs:
    """Points with a feature along one word each (-1: no view), two boxes that overlap, and looks at some tracks."""
    state = np.where(np.array(words) < 0, NO_VIEW, SEEN).astype(np.int8)
    feature = (np.eye(COMPONENTS, dtype=np.int8) * 100)[[word for word in words if word >= 0]]
    basis = Basis(
        np.zeros(COMPONENTS, np.float32),
        np.eye(COMPONENTS, dtype=np.float32),
        np.full(COMPONENTS, 0.01, np.float32),
        1.0,
    )
    pair = Boxes.from_rows(
        np.array([[10.0, 0, 1, 4, 2, 2, 0], [12, 0, 1, 4, 2, 2, 0], [40, 0, 1, 4, 2, 2, 0]])
    )
    return MemoryInputs(
        {
            "pca": [PcaRow("all", 0, basis.mean, basis.components.ravel(), basis.scale, 1.0)],
            "extract-vl": [ExtractVlRow(SEGMENT, 0, state, np.zeros(len(state), np.int8), feature)],
            "mask": [MaskRow(SEGMENT, 0, np.ones(len(state), bool), np.array(background, np.int8))],
            "nms": [amodal_row(0, pair, [7, 8, 9])],
            "looks": [looks_row(0, [7, 8, 9], looks)],
        },
        MemoryDrive({0: np.array(xyz_m)}),
        TwoWords(),
    )


XYZ_M = [[9.7, 0, 1], [11, 0, 1], [13, 0, 1], [9.5, 0, 1], [11, 0.5, 1], [60, 0, 1], [9.0, 0, 1.5]]
WORDS = [0, 1, 2, -1, 2, 1, 2]
BACKGROUND = [0, 0, 0, 0, 0, 0, 1]


def test_points_in_boxes_that_overlap_count_for_both_and_background_for_none() -> None:
    inputs = drive_of_points(WORDS, XYZ_M, BACKGROUND)
    (row,) = pool_features.run(inputs, pool_features.PoolFeaturesConfig())
    assert row.num_features.tolist() == [3, 3, 0]
    assert row.point_feature.values.argmax(axis=1).tolist() == [0, 1, 2, 1, 2, 2]
    assert row.pooled[:, :3].tolist() == [[33, 33, 33], [0, 33, 67], [0, 0, 0]]
    assert row.track_id.tolist() == [7, 8, 9]
    assert inputs.counts == {"labels with features": 2, "labels that no camera sees": 1}


def test_a_frame_without_features_pools_none() -> None:
    (row,) = pool_features.run(
        drive_of_points([-1] * 7, XYZ_M, BACKGROUND), pool_features.PoolFeaturesConfig()
    )
    assert row.num_features.tolist() == [0, 0, 0]
    assert not row.pooled.any()


CONFIG = classify.ClassifyConfig(
    vehicle=("car",),
    pedestrian=("walker",),
    cyclist=("bicycle",),
    other=("wall",),
    kinds=classify.KindsConfig(vehicle=("tram", "car"), pedestrian=("child",), cyclist=()),
    looks=LookVoteConfig(temperature=0.05, weight=0.5),
)


def along(word: int) -> np.ndarray:
    """The feature of a look along one word."""
    return (np.eye(COMPONENTS, dtype=np.int8) * 100)[word]


def test_the_points_of_a_track_choose_its_word() -> None:
    assert CONFIG.words == ([1, 2, 4, 0], ["car", "walker", "bicycle", "wall"])
    assert CONFIG.kind_words == ([1, 2], ["tram", "child"])  # "car" stands above
    inputs = drive_of_points(WORDS, XYZ_M, BACKGROUND)
    (row,) = classify.run(inputs, CONFIG)
    assert row.track_id.tolist() == [7, 8, 9]
    # One vote each in the first box, the lowest number wins; two cyclists of three in the second; none in the third.
    assert row.type.tolist() == [1, 4, 0]
    assert row.word.tolist() == ["car", "bicycle", ""]
    np.testing.assert_allclose(row.share, [1 / 3, 2 / 3, 0])
    assert row.look_word.tolist() == [["", "", ""]] * 3
    assert not row.look_share.any()
    assert row.words_agree.all()
    assert inputs.counts == {
        "vehicles": 1, "cyclists": 1, "others": 1, "pedestrians": 0, "labels whose points and looks disagree": 0,
    }  # fmt: skip


def test_looks_choose_with_the_points_and_alone_where_there_are_none() -> None:
    looks = {8: along(4), 9: along(5)}  # a tram, a child
    inputs = drive_of_points(WORDS, XYZ_M, BACKGROUND, looks)
    (row,) = classify.run(inputs, CONFIG)
    # Of the second box the points say bicycle by two of three, and the look nearly surely tram.
    assert row.type.tolist() == [1, 1, 2]
    assert row.word.tolist() == ["car", "tram", "child"]
    np.testing.assert_allclose(row.share, [1 / 3, 1 / 2, 1], atol=1e-6)
    assert row.look_word[:, 0].tolist() == ["", "tram", "child"]
    np.testing.assert_allclose(row.look_share[:, 0], [0, 1, 1], atol=1e-6)
    assert row.words_agree.tolist() == [True, False, True]
    assert inputs.counts["labels whose points and looks disagree"] == 1


def test_points_do_not_vote_for_kinds() -> None:
    inputs = drive_of_points([4] * 7, XYZ_M, BACKGROUND)
    (row,) = classify.run(inputs, CONFIG)
    assert row.word.tolist()[:2] == ["car", "car"]


def test_pooled_features_come_with_those_of_the_looks() -> None:
    inputs = drive_of_points(WORDS, XYZ_M, BACKGROUND, {8: along(4)})
    (row,) = pool_features.run(inputs, pool_features.PoolFeaturesConfig())
    assert row.num_looks.tolist() == [0, 1, 0]
    assert row.look_feature[1].tolist() == along(4).tolist()
    assert not row.look_feature[[0, 2]].any()
