"""The shape of a car, a bush and a wall, and what tells them from each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception.amodal.sightings import Sightings
from upvl_cli.perception.objectness.ring import ring_counts
from upvl_cli.perception.objectness.shape import SHAPE_FEATURES, frame_shape
from upvl_cli.perception.objectness.track_features import FEATURES, track_features
from upvl_cli.stages.amodal import AmodalConfig
from upvl_cli.types import Array, Boxes

CONFIG = load(AmodalConfig, Path(__file__).parents[3] / "stages" / "amodal.toml").objectness
SIZE_LWH_M = np.array([4.0, 2.0, 1.5])


def panels() -> Array:
    """Two sides of a box of 4 x 2 x 1.5 m about the origin, on the ground."""
    along, up = np.meshgrid(np.linspace(-2, 2, 41), np.linspace(0.2, 1.5, 14))
    across, high = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(0.2, 1.5, 14))
    side = np.column_stack([along.ravel(), np.full(along.size, -1.0), up.ravel()])
    end = np.column_stack([np.full(across.size, -2.0), across.ravel(), high.ravel()])
    return np.vstack([side, end])


def shape(xyz_m: Array, size_lwh_m: Array = SIZE_LWH_M, ring_points: int = 0) -> dict[str, float]:
    """The features of one frame by name."""
    values = frame_shape(xyz_m, xyz_m[:, 2], size_lwh_m, ring_points, CONFIG)
    return dict(zip(SHAPE_FEATURES, values.tolist(), strict=True))


def test_extents_and_heights_are_those_of_the_points() -> None:
    found = shape(panels())
    assert found["top_across_m"] == pytest.approx(2.0, abs=0.1)
    assert found["top_along_m"] == pytest.approx(4.0, abs=0.2)
    assert found["seen_length"] == pytest.approx(1.0, abs=0.05)
    assert found["seen_width"] == pytest.approx(1.0, abs=0.05)
    assert found["seen_height_m"] == pytest.approx(1.5)
    assert found["lowest_m"] == pytest.approx(0.2)
    assert found["vertical_gap_m"] == pytest.approx(0.1, abs=1e-6)
    assert found["depth_m"] == pytest.approx(0.0, abs=1e-9), "all points lie on its faces"


def test_the_top_of_a_tapered_thing_is_narrow_and_a_crown_leaves_a_gap() -> None:
    body = panels()
    cone = body * np.column_stack([1.6 - body[:, 2]] * 2 + [np.ones(len(body))])
    assert shape(cone)["top_across_m"] < 0.6
    trunk = np.vstack([body[body[:, 2] < 0.35], body[body[:, 2] > 1.1]])
    assert shape(trunk)["vertical_gap_m"] > 0.7


def test_panels_are_planes_along_the_box_and_leaves_are_not() -> None:
    rng = np.random.default_rng(0)
    car, bush = shape(panels()), shape(rng.uniform([-2, -1, 0.2], [2, 1, 1.5], (800, 3)))
    assert car["planarity"] > bush["planarity"] + 0.2
    assert car["scatter"] < 0.1 < bush["scatter"]
    assert car["alignment"] > 0.95 > bush["alignment"]
    assert bush["depth_m"] > 0.2
    wire = np.column_stack([np.linspace(-2, 2, 200), np.zeros(200), np.full(200, 1.0)])
    wire[::2, 2] += 1e-3
    assert shape(wire)["linearity"] > 0.9


def test_few_points_have_no_neighborhoods() -> None:
    found = shape(panels()[::120])
    assert np.isnan([found["linearity"], found["planarity"], found["scatter"], found["alignment"]]).all()
    assert np.isfinite(found["top_across_m"])


@pytest.mark.parametrize("heading_rad", [0.0, 0.7])
def test_points_of_the_ring_are_those_between_its_distances_and_above_the_ground(heading_rad: float) -> None:
    boxes = Boxes(np.array([[5.0, 3.0, 0.75]]), SIZE_LWH_M[None], np.array([heading_rad]))
    way = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    beyond_m = np.array([0.5, 0.69, 0.71, 1.0, 1.49, 1.51, 3.0])
    xy_m = boxes.center_m[0, :2] + (2.0 + beyond_m)[:, None] * way
    xyz_m = np.column_stack([xy_m, np.full(7, 0.8)])
    assert ring_counts(xyz_m, np.full(7, 0.8), boxes, CONFIG).tolist() == [3]
    assert ring_counts(xyz_m, np.full(7, 0.1), boxes, CONFIG).tolist() == [0], "on the ground"
    assert ring_counts(xyz_m[:0], np.zeros(0), boxes, CONFIG).tolist() == [0]


def sightings(clouds: list[Array], speed_mps: float = 0.0) -> tuple[Sightings, Boxes]:
    """A thing that is seen frame by frame, and its boxes."""
    time_s = np.arange(len(clouds)) * 0.5
    center_m = np.column_stack([speed_mps * time_s, np.zeros(len(clouds)), np.full(len(clouds), 0.75)])
    boxes = Boxes(center_m, np.tile(SIZE_LWH_M, (len(clouds), 1)), np.zeros(len(clouds)))
    moved = [cloud + [speed_mps * time, 0, 0] for cloud, time in zip(clouds, time_s, strict=True)]
    velocity = np.tile([speed_mps, 0.0, 0.0], (len(clouds), 1))
    sensor = center_m[:, :2] - [10.0, 0.0]
    heights = [cloud[:, 2] for cloud in clouds]
    return Sightings(time_s, moved, heights, boxes, velocity, sensor, np.zeros(len(clouds))), boxes


def test_a_track_is_measured_in_the_denser_half_of_its_frames() -> None:
    rng = np.random.default_rng(0)
    leaves = rng.uniform([-2, -1, 0.2], [2, 1, 1.5], (60, 3))
    seen, boxes = sightings([panels(), leaves, panels(), leaves, panels()], speed_mps=2.0)
    found = dict(zip(FEATURES, track_features(seen, boxes, np.zeros(5, int), CONFIG).tolist(), strict=True))
    centered = panels() - [0, 0, 0.75]
    alone = frame_shape(centered, panels()[:, 2], SIZE_LWH_M, 0, CONFIG)
    np.testing.assert_allclose([found[name] for name in SHAPE_FEATURES], alone)
    assert (found["seconds"], found["seen_share"]) == (2.0, 1.0)
    assert (found["speed_mps"], found["reach_m"]) == (2.0, 4.0)
    assert (found["length_m"], found["width_m"], found["height_m"]) == (4.0, 2.0, 1.5)


def test_a_track_without_points_has_no_shape_and_still_a_size() -> None:
    seen, boxes = sightings([panels()[:2], np.zeros((0, 3))])
    found = dict(zip(FEATURES, track_features(seen, boxes, np.zeros(2, int), CONFIG).tolist(), strict=True))
    assert np.isnan([found[name] for name in SHAPE_FEATURES]).all()
    assert found["seen_share"] == 0.5
