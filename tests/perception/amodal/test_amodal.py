"""A box of known size, seen side by side from a moving sensor, is asked back whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.geometry.boxes import corners_bev
from upvl_cli.geometry.iou import iou_3d_pairs
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.perception.amodal.fit import fit_amodal_boxes
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.box_fit import tight_box
from upvl_cli.stages.amodal import AmodalConfig
from upvl_cli.types import Array, Boxes, concat

CONFIG = load(AmodalConfig, Path(__file__).parents[3] / "stages" / "amodal.toml")
CAR_LWH_M = np.array([4.4, 1.9, 1.5])


def fitted(seen: Sightings, config: AmodalConfig = CONFIG) -> np.ndarray:
    """The (T, 7) rows of the boxes."""
    return fit_amodal_boxes(seen, config).boxes.to_rows()


def overlap(box: np.ndarray, other: np.ndarray) -> float:
    """3D IoU of two rows."""
    return float(iou_3d_pairs(Boxes.from_rows(box[None]), Boxes.from_rows(other[None]))[0])


def tight_boxes(clouds: Sequence[np.ndarray], heading_rad: float) -> Boxes:
    """The tight box of each cloud."""
    return concat([tight_box(cloud, heading_rad, trim=0.0) for cloud in clouds], Boxes)


def face_points(box: np.ndarray, sensor_xy_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points on the sides of an upright box that face the sensor, with 2 cm of noise."""
    corners = corners_bev(Boxes.from_rows(box[None]))[0]
    clouds = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        outward = np.array([end[1] - start[1], start[0] - end[0]])
        if outward @ (sensor_xy_m - start) > 0:
            share = rng.uniform(0, 1, (60, 1))
            up = rng.uniform(-0.5, 0.5, 60) * box[5] + box[2]
            clouds.append(np.column_stack([start + share * (end - start), up]))
    return np.concatenate(clouds) + rng.normal(0, 0.02, (60 * len(clouds), 3))


def drive_past(heading_rad: float, frames: int = 12) -> tuple[Sightings, np.ndarray]:
    """A car at 8 m/s, seen at its front and one side by a sensor that comes closer; and its true boxes."""
    rng = np.random.default_rng(1)
    way = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    aside = np.array([-way[1], way[0]])
    time_s = np.arange(frames) * 0.1
    truth = np.array([[*(5.0 * aside + 8 * t * way), 0.75, *CAR_LWH_M, heading_rad] for t in time_s])
    sensor = truth[:, :2] + (16 - 6 * time_s[:, None]) * way - 5.0 * aside
    clouds = [face_points(box, eye, rng) for box, eye in zip(truth, sensor, strict=True)]
    seen = tight_boxes(clouds, heading_rad)
    velocity = np.tile([*(8 * way), 0.0], (frames, 1))
    heights = [cloud[:, 2] for cloud in clouds]
    return Sightings(time_s, clouds, heights, seen, velocity, sensor, np.zeros(frames)), truth


@pytest.mark.parametrize("heading_rad", [0.0, 0.6, 2.0, -2.8])
def test_a_passing_car_is_found_whole(heading_rad: float) -> None:
    seen, truth = drive_past(heading_rad)
    boxes = fitted(seen)
    np.testing.assert_allclose(boxes[:, 3:6], np.tile(CAR_LWH_M, (len(boxes), 1)), rtol=0.1)
    assert len(np.unique(boxes[:, 3:6].round(9), axis=0)) == 1, "one size a track"
    assert np.linalg.norm(boxes[:, :2] - truth[:, :2], axis=1).max() < 0.25
    assert np.abs(wrap_angle(boxes[:, 6] - truth[:, 6])).max() < np.deg2rad(5)


def test_the_same_bytes_twice() -> None:
    seen, _ = drive_past(0.6)
    assert fitted(seen).tobytes() == fitted(seen).tobytes()


def test_frames_without_points_keep_the_size_and_follow_the_track() -> None:
    seen, truth = drive_past(0.0)
    clouds, heights = list(seen.xyz_m), list(seen.height_m)
    for gap in (4, 5):
        clouds[gap], heights[gap] = np.zeros((0, 3)), np.zeros(0)
        seen.boxes.center_m[gap, :2] = truth[gap, :2]
    boxes = fitted(replace(seen, xyz_m=clouds, height_m=heights))
    assert np.isfinite(boxes).all()
    assert np.linalg.norm(boxes[[4, 5], :2] - truth[[4, 5], :2], axis=1).max() < 1.0


def test_a_track_of_one_frame() -> None:
    seen, truth = drive_past(0.0, frames=1)
    boxes = fitted(seen)
    assert boxes.shape == (1, 7)
    assert np.linalg.norm(boxes[0, :2] - truth[0, :2]) < 1.5


def parked(
    heading_rad: float, eye_xy_m: tuple[float, float], lwh_m: np.ndarray = CAR_LWH_M
) -> tuple[Sightings, Array]:
    """A thing that stands at (10, 5), seen from one place in six frames; and its true box."""
    rng = np.random.default_rng(2)
    truth = np.array([10.0, 5.0, lwh_m[2] / 2, *lwh_m, heading_rad])
    eye = np.tile(eye_xy_m, (6, 1)).astype(float)
    clouds = [face_points(truth, at, rng) for at in eye]
    seen = tight_boxes(clouds, 0.0)
    heights = [cloud[:, 2] for cloud in clouds]
    return Sightings(np.arange(6) * 0.1, clouds, heights, seen, np.zeros((6, 3)), eye, np.zeros(6)), truth


@pytest.mark.parametrize(
    ("heading_rad", "eye_xy_m"),
    [
        (0.0, (10.0, -5.0)),  # its side alone
        (0.2, (0.0, 0.0)),  # a corner
        (np.pi / 2, (0.0, 5.0)),  # across the way: its side alone
        (0.0, (-5.0, 5.0)),  # its end alone
        (1.3, (0.0, 0.0)),
    ],
)
def test_what_is_parked_lies_along_its_long_side_or_behind_its_end(
    heading_rad: float, eye_xy_m: tuple[float, float]
) -> None:
    seen, truth = parked(heading_rad, eye_xy_m)
    box = fitted(seen)[0]
    assert abs(wrap_angle(2 * (box[6] - heading_rad))) < np.deg2rad(10), "along, either way"
    assert np.cos(box[6]) > -1e-9, "at an acute angle to the ego heading"
    assert overlap(box, truth) > 0.5


def test_of_a_person_one_side_is_seen() -> None:
    seen, truth = parked(0.0, (0.0, 5.0), np.array([0.8, 0.6, 1.7]))
    assert overlap(fitted(seen)[0], truth) > 0.5


def test_a_child_is_slimmer_than_an_adult() -> None:
    seen, truth = parked(0.0, (10.0, -5.0), np.array([0.5, 0.4, 1.1]))
    assert overlap(fitted(seen)[0], truth) > 0.6


def test_who_pushes_a_pram_is_not_the_end_of_a_car() -> None:
    seen, truth = parked(0.3, (5.0, -10.0), np.array([1.6, 0.6, 1.9]))
    clouds, heights = [], []
    for cloud, height in zip(seen.xyz_m, seen.height_m, strict=True):
        ahead = (cloud[:, :2] - truth[:2]) @ [np.cos(0.3), np.sin(0.3)]
        kept = (height < 1.1) | (ahead < -0.2)  # above the pram there is nothing
        clouds.append(cloud[kept])
        heights.append(height[kept])
    boxes = tight_boxes(clouds, 0.0)
    box = fitted(replace(seen, xyz_m=clouds, height_m=heights, boxes=boxes))[0]
    assert abs(wrap_angle(2 * (box[6] - 0.3))) < np.deg2rad(20)
    assert overlap(box, truth) > 0.5


def test_a_foot_that_is_hidden_for_a_while_is_still_on_the_ground() -> None:
    seen, truth = drive_past(0.0)
    clouds, heights = list(seen.xyz_m), list(seen.height_m)
    for at in (5, 6, 7):  # all but the roof is behind something
        high = clouds[at][:, 2] > 1.2
        clouds[at], heights[at] = clouds[at][high], heights[at][high]
    boxes = tight_boxes(clouds, 0.0)
    found = fitted(replace(seen, xyz_m=clouds, height_m=heights, boxes=boxes))
    np.testing.assert_allclose(found[:, 2], truth[:, 2], atol=0.1)


@pytest.mark.parametrize("seen_m", [(2.6, 0.1), (0.4, 1.5)])
def test_a_part_longer_or_wider_than_any_bicycle_belongs_to_a_car(seen_m: tuple[float, float]) -> None:
    part = np.array([*seen_m, 1.4])
    seen, _ = parked(0.0, (0.0, -5.0), part)
    length, width, _ = fitted(seen)[0, 3:6]
    assert length >= 3.8
    assert 1.4 <= width < 2.0
