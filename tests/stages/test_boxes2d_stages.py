"""From 2D boxes to labels: a stage that is off, a table of boxes, people who are lifted, and matches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from memory_inputs import SEGMENT, MemoryInputs, amodal_row, boxes2d_row
from test_propose_stage import CONFIG, FRAMES, boxes_of, drive
from test_windowed_stages import scene, tracked

from upvl_cli.config.toml import load
from upvl_cli.pipeline.tables import Table, write
from upvl_cli.stages import amodal, boxes2d, match_boxes2d
from upvl_cli.stages.picture_rows import Boxes2dRow
from upvl_cli.stages.rows import OdometryRow
from upvl_cli.types import Boxes, Boxes2d, Camera, Frame, Image

STAGES = Path(__file__).parents[2] / "stages"
SHIPPED = load(boxes2d.Boxes2dConfig, STAGES / "boxes2d.toml")
FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
CAMERA = Camera(
    "front", 1200, 400, np.array([[700.0, 0, 599.5], [0, 700, 199.5], [0, 0, 1]]), np.zeros(5), FORWARD
)


@dataclass
class PictureDrive:
    """Two frames of two cameras, of which one has no picture in the second frame."""

    is_open: bool = True
    name: str = SEGMENT
    cameras: tuple[Camera, ...] = (replace(CAMERA, name="left"), CAMERA)
    frames: tuple[Frame, ...] = (Frame(3, 0), Frame(5, 10**8))

    def image(self, frame: int, camera: str) -> Image | None:
        assert self.is_open, "a picture was opened"
        rgb = np.zeros((400, 1200, 3), np.uint8)
        return None if (frame, camera) == (5, "left") else Image(rgb, frame * 10 + len(camera))


def table(path: Path) -> Path:
    pq.write_table(
        pa.table(
            {
                "segment": [SEGMENT] * 3,
                "frame": [3, 3, 5],
                "camera": ["front", "left", "front"],
                "x1": [1.0, 2, 3],
                "y1": [1.0, 2, 3],
                "x2": [11.0, 12, 13],
                "y2": [21.0, 22, 23],
                "score": [0.9, 0.1, 0.8],
                "name": ["car", "bus", "person"],
            }
        ),
        path,
    )
    return path


def test_without_a_detector_no_picture_is_opened() -> None:
    assert (
        SHIPPED.detector == "none"
        and SHIPPED.files(SEGMENT) == ()
        and SHIPPED.values() == {"detector": "none"}
    )
    rows = list(boxes2d.run(MemoryInputs({}, PictureDrive(is_open=False)), SHIPPED))  # type: ignore[arg-type]
    assert [(row.frame, len(row.camera), len(row.has_image)) for row in rows] == [(3, 0, 0), (5, 0, 0)]


def test_boxes_stand_with_their_camera_and_the_time_of_its_picture(tmp_path: Path) -> None:
    path = table(tmp_path / "boxes.parquet")
    config = replace(SHIPPED, detector=f"table:{path}", min_score=0.2)
    assert config.files(SEGMENT) == (path,)
    assert config.values() == {"detector": "table", "min_score": 0.2, "version": 1}  # not where the file is
    inputs = MemoryInputs({}, PictureDrive())  # type: ignore[arg-type]
    shard = tmp_path / "out" / "boxes2d" / f"{SEGMENT}.parquet"
    write(shard, Boxes2dRow, boxes2d.run(inputs, config), stamp="{}", counts={})  # type: ignore[arg-type]
    first, second = Table(shard, Boxes2dRow)
    assert (first.has_image.tolist(), second.has_image.tolist()) == ([True, True], [False, True])
    assert (first.image_time_ns.tolist(), second.image_time_ns.tolist()) == ([34, 35], [0, 55])
    assert (first.camera.tolist(), first.name.tolist()) == ([1], ["car"])  # the bus has too low a score
    np.testing.assert_array_equal(first.xyxy_px, [[0.5, 0.5, 10.5, 20.5]])
    assert second.boxes2d.name.tolist() == ["person"]
    assert inputs.counts == {"2D boxes": 2, "pictures": 3, "pictures missing": 1}


def with_people(inputs: MemoryInputs, edges_px: list[float], name: str) -> MemoryInputs:
    assert inputs.drive is not None
    inputs.drive.cameras = (CAMERA,)
    shown = Boxes2d(np.array([edges_px]), np.array([0.9]), np.array([name]))
    inputs.tables["boxes2d"] = [
        replace(boxes2d_row(pose.frame, shown, cameras=1), image_time_ns=np.array([pose.time_ns]))
        for pose in inputs.tables["odometry"]
    ]
    return inputs


# The object of `drive` is a solid of 4 x 2 x 1.6 m whose near side is 13 m ahead, at 3 to 5 m to the left.
AROUND = [329.0, 194, 600, 260]
LIFTING = replace(
    CONFIG, frustum=replace(CONFIG.frustum, max_depth_m=9.0, min_height_m=0.5, max_height_m=20.0)
)


def test_what_words_call_background_is_lifted_where_a_picture_shows_a_person() -> None:
    wall: dict[str, Any] = {"background": np.ones(2 * 13 * 7 * 4, np.int8)}
    rows = boxes_of(with_people(drive(0.0, 0.0, **wall), AROUND, "person"), LIFTING)
    assert [row.is_lifted.tolist() for row in rows] == [[True]] * FRAMES
    np.testing.assert_allclose(rows[0].center_m, [[15, 4, 0.8]], atol=0.05)
    assert rows[0].hypothesis.tolist() == [len(CONFIG.clustering.eps_m)]
    for name in ("car", "bench"):
        rows = boxes_of(with_people(drive(0.0, 0.0, **wall), AROUND, name), LIFTING)
        assert [len(row.center_m) for row in rows] == [0] * FRAMES


def test_what_is_a_proposal_already_is_its_duplicate() -> None:
    plain = boxes_of(drive(6.0, 9.0))
    rows = boxes_of(with_people(drive(6.0, 9.0), [0, 0, 1199, 399], "cyclist"), LIFTING)
    for before, row in zip(plain, rows, strict=True):
        if row.is_lifted.any():
            assert row.duplicate_of.tolist() == [-1, 0]
        np.testing.assert_array_equal(row.center_m[:1], before.center_m)
    assert any(row.is_lifted.any() for row in rows)


def test_words_do_not_call_background_what_a_picture_shows() -> None:
    """All points are background by words: tracks stay where 2D boxes show them."""
    shares = []
    for is_lifted in (False, True):
        inputs = scene(6)
        for name, values in (("mask", {"background": 1}), ("propose", {"is_lifted": is_lifted})):
            inputs.tables[name] = [
                replace(row, **{key: np.full_like(getattr(row, key), value) for key, value in values.items()})
                for row in inputs.tables[name]
            ]
        shares.append(amodal.track_totals(tracked(inputs)).background_share)
    assert set(shares[0].tolist()) == {1.0} and set(shares[1].tolist()) == {0.0}


def odometry(frames: int) -> list[OdometryRow]:
    measured = (True, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    return [OdometryRow(SEGMENT, frame, frame * 10**8, np.eye(4), *measured) for frame in range(frames)]


# A cube of 2 m whose near face is 10 m ahead, 1.5 m above the road as the camera is: 140 px around (599.5, 199.5).
CUBE = Boxes.from_rows(np.array([[11.0, 0, 1.5, 2, 2, 2, 0], [-20, 0, 1.5, 2, 2, 2, 0]]))
FACE = np.array([[529.5, 129.5, 669.5, 269.5]])


def matches(shown: list[Boxes2dRow], **values: Any) -> list[Any]:
    labels = [amodal_row(frame, CUBE, [7, 8], **values) for frame in range(len(shown))]
    inputs = MemoryInputs({"odometry": odometry(len(shown)), "boxes2d": shown, "nms": labels})
    inputs.drive = PictureDrive(cameras=(CAMERA,))  # type: ignore[assignment]
    return list(match_boxes2d.run(inputs, match_boxes2d.MatchBoxes2dConfig(min_iou=0.4)))


def test_names_vote_over_the_frames_of_a_track() -> None:
    names = ("bus", "train", "train")
    shown = [
        boxes2d_row(frame, Boxes2d(FACE, np.array([0.5]), np.array([name])), cameras=1)
        for frame, name in enumerate(names)
    ]
    rows = matches(shown)
    for row, name in zip(rows, names, strict=True):
        np.testing.assert_allclose(row.iou_2d, [1.0, -1.0], atol=1e-6)
        assert (row.camera.tolist(), row.name.tolist()) == ([0, -1], [name, ""])
        assert row.word.tolist() == ["train", ""]
        np.testing.assert_allclose(row.share, [2 / 3, 0])
        np.testing.assert_allclose(row.votes, [1.5, 0])


def test_without_a_detector_nothing_is_known() -> None:
    (row,) = matches([boxes2d_row(0)])
    assert (row.iou_2d.tolist(), row.word.tolist(), row.camera.tolist()) == ([-1, -1], ["", ""], [-1, -1])


@pytest.mark.parametrize(("late_ns", "shifted"), [(0, 0), (10**8, 28)])
def test_a_label_is_moved_to_the_time_of_the_picture(late_ns: int, shifted: int) -> None:
    """At 4 m/s it is 0.4 m to the left 0.1 s later: 28 px of 140, at 10 m."""
    velocity = np.array([[0.0, 4, 0], [0, 0, 0]])
    shown = replace(
        boxes2d_row(0, Boxes2d(FACE, np.array([0.5]), np.array(["car"])), cameras=1),
        image_time_ns=np.array([late_ns]),
    )
    (row,) = matches([shown], velocity_mps=velocity)
    assert row.iou_2d[0] == pytest.approx((140 - shifted) / (140 + shifted), abs=1e-6)
