"""What is collected for scoring: types joined by track, views of all cameras, objects of any class."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scored_world import material, write_auto_labels

from command import make_workspace
from tiny_kitti import write_drive
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.datasets.label_registry import LABELS
from upvl_cli.datasets.labels import LabelSource
from upvl_cli.evaluation.gather import _in_view, gather
from upvl_cli.evaluation.region import Region
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Bools, Boxes, Camera

BOX = np.array([12.0, 0.0, -1.0, 4.0, 2.0, 1.5, 0.0])
SHIFT_M = (0.0, 3.0, 6.0, -42.0)  # of the four boxes along x: the last one is behind the camera


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A drive of four frames whose second one has boxes of the tracks 9, 4, 7 and 5."""
    folder = tmp_path_factory.mktemp("gather")
    drive = write_drive(folder / "drives")
    work = make_workspace(folder / "work", raw__dataset='"kitti"', raw__root=f'"{drive.root}"')
    boxes = [
        (BOX + np.eye(7)[0] * shift, 0.5, track) for shift, track in zip(SHIFT_M, (9, 4, 7, 5), strict=True)
    ]
    write_auto_labels(work, drive.segment, {0: [], 1: boxes, 2: [], 3: []})
    workspace = Workspace(PIPELINE, work / "stages", work / "out")
    stage = PIPELINE.by_name["classify"]
    tracks = {0: [], 1: [7, 9, 5, 4], 2: [], 3: []}  # in another order than the boxes
    kinds = {9: 1, 4: 2, 7: 4, 5: 1}
    rows = [
        stage.row(
            segment=drive.segment,
            frame=frame,
            track_id=np.array(ids, dtype=np.int64),
            type=np.array([kinds[track] for track in ids], dtype=np.int8),
            word=np.array(["thing"] * len(ids), dtype=str),
            share=np.ones(len(ids), dtype=np.float32),
            num_looks=np.zeros(len(ids), dtype=np.int32),
            look_word=np.full((len(ids), 3), "", dtype=str),
            look_share=np.zeros((len(ids), 3)),
            words_agree=np.ones(len(ids), dtype=bool),
        )
        for frame, ids in tracks.items()
    ]
    stamp = workspace.shard_stamp(stage, drive.segment)
    write(workspace.shard(stage.name, drive.segment), stage.row, rows, stamp=stamp, counts={})
    return workspace


def test_types_are_joined_by_track_not_by_order(workspace: Workspace) -> None:
    found = gather(workspace, "nms", region=None, named=True)
    assert found.has_class
    assert dict(zip(found.predictions.object_id.tolist(), found.predictions.type.tolist(), strict=True)) == {
        "9": 1,
        "4": 2,
        "7": 4,
    }
    assert gather(workspace, "nms", region=None).predictions.type.tolist() == [0, 0, 0]


def test_parts_of_boxes_and_frames_arrive_as_they_were_written(workspace: Workspace) -> None:
    found = gather(workspace, "nms", region=None).predictions
    np.testing.assert_array_equal(found.to_rows(), [BOX + np.eye(7)[0] * shift for shift in SHIFT_M[:3]])
    assert found.frame.tolist() == [1, 1, 1]
    np.testing.assert_array_equal(found.velocity_mps, [[8.0, 0.0]] * 3)


def test_a_box_outside_of_view_and_region_is_counted_once(workspace: Workspace) -> None:
    # Ahead the boxes are at 12, 15 and 18 m, and one is 30 m behind: out of view, and so out of no region.
    dropped = gather(workspace, "nms", region=Region(28.0, 40.0)).dropped
    assert dropped["boxes outside the region"] == 2
    assert dropped["boxes outside the labelled view"] == 1


def test_a_place_is_in_view_where_any_camera_sees_it() -> None:
    """One camera looks ahead along x, one astern; whichever comes first, both places are seen."""
    intrinsic = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])
    x_ahead = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    ahead = Camera("ahead", 100, 100, intrinsic, np.zeros(5), x_ahead)
    astern = replace(ahead, ego_from_camera=np.diag([-1.0, -1.0, 1.0, 1.0]) @ x_ahead)
    places = np.array([[10.0, 0, 0], [-10, 0, 0], [0, 10, 0]])
    assert _in_view((ahead, astern), places).tolist() == [True, True, False]
    assert _in_view((astern, ahead), places).tolist() == [True, True, False]
    assert _in_view((astern,), places).tolist() == [False, True, False]
    assert _in_view((), places).tolist() == [False, False, False]


def test_every_road_user_is_an_object_and_a_sign_is_none() -> None:
    case = material([(0, 10.0 * place, 0, 5.0) for place in range(5)], [(0, 0, 0, 0.9)])
    case = replace(case, labels=replace(case.labels, type=np.arange(5)))
    assert case.without_classes().labels.type.tolist() == [1, 1, 1, 3, 1]


class ZonesBeyond14m:
    """KITTI's labels, with everything farther than 14 m ahead left without labels."""

    def __init__(self, source: LabelSource) -> None:
        self.labels, self.frames, self.covers = source.labels, source.frames, source.covers

    def unlabelled(self, segment: str, frame: int, boxes: Boxes) -> Bools:
        return np.asarray((boxes.center_m[:, 0] > 14) & (frame == 1))


def test_boxes_in_zones_without_labels_are_no_false_positives(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not gather(workspace, "nms", region=None).predictions.unlabelled.any()
    kitti = LABELS["kitti"]
    monkeypatch.setitem(LABELS, "kitti", lambda root, dataset: ZonesBeyond14m(kitti(root, dataset)))
    found = gather(workspace, "nms", region=None).predictions
    np.testing.assert_array_equal(found.unlabelled, found.center_m[:, 0] > 14)
    assert found.unlabelled.any() and not found.unlabelled.all()
