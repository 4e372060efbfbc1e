"""Objects behind 2D boxes, in clouds by construction: few points, walls behind, posts before, known clusters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.perception.proposals.frustum import CameraBoxes, frustum_clusters
from upvl_cli.stages.propose import ProposeConfig
from upvl_cli.types import Boxes2d, Camera

CONFIG = load(ProposeConfig, Path(__file__).parents[3] / "stages" / "propose.toml").frustum
FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
CAMERA = Camera(
    "front", 400, 200, np.array([[400.0, 0, 199.5], [0, 400, 99.5], [0, 0, 1]]), np.zeros(5), FORWARD
)
NONE = np.zeros((0, 3))


def person(x_m: float, y_m: float, points: int = 8) -> np.ndarray:
    """A person of 1.8 m, 0.4 m wide, as a sensor ahead sees the front."""
    share = np.linspace(0.1, 0.9, points)
    return np.column_stack([np.full(points, x_m), y_m + 0.2 * np.cos(9 * share), 1.8 * share])


def wall(x_m: float, columns: int = 41) -> np.ndarray:
    across, up = np.meshgrid(np.linspace(-4, 4, columns), np.linspace(0.4, 3, 8))
    return np.column_stack([np.full(across.size, x_m), across.ravel(), up.ravel()])


def box(x_m: float, y_m: float, *, name: str = "person", score: float = 0.8, high_m: float = 1.8) -> Boxes2d:
    """The 2D box around a person at that place."""
    left, right = (199.5 - 400 * side / x_m for side in (y_m + 0.25, y_m - 0.25))
    top, bottom = (99.5 - 400 * (z_m - 1.5) / x_m for z_m in (high_m, 0.0))
    return Boxes2d(np.array([[left, top, right, bottom]]), np.array([score]), np.array([name]))


def lifted(clouds: list[np.ndarray], *boxes: Boxes2d, given: tuple[np.ndarray, ...] = (), **changes: float):  # noqa: ANN201
    """Points of each object, and the counts."""
    xyz_m = np.concatenate(clouds)
    pictures = [CameraBoxes(CAMERA, xyz_m, each) for each in boxes]
    label, counts = frustum_clusters(pictures, given, len(xyz_m), replace(CONFIG, **changes))
    return [np.flatnonzero(label == number).tolist() for number in range(label.max(initial=-1) + 1)], counts


def test_a_far_person_of_three_points_is_an_object() -> None:
    objects, counts = lifted([person(45, 2, 3), wall(60, columns=17)], box(45, 2))
    assert objects == [[0, 1, 2]]
    assert counts == {"2D boxes lifted": 1}
    objects, counts = lifted([person(45, 2, 2)], box(45, 2))
    assert objects == [] and counts == {"2D boxes without enough points": 1}


def test_a_wall_close_behind_is_no_part_of_it() -> None:
    cloud = person(20, 1, 12)
    objects, _ = lifted([cloud, wall(21)], box(20, 1))
    assert objects == [list(range(12))]
    # Without a gap the extent in depth bounds it.
    hedge = np.concatenate([wall(20.4 + 0.4 * step) for step in range(12)])
    (members,), _ = lifted([cloud, hedge], box(20, 1), max_height_m=3.0, min_filled=0.1)
    depth = np.concatenate([cloud, hedge])[members, 0]
    assert depth.max() - depth.min() <= CONFIG.max_depth_m


def test_a_post_before_it_is_left_out() -> None:
    """The post is nearer and thin, beside the middle: few of the points in the middle are on it."""
    post = np.column_stack([np.full(3, 12.0), np.full(3, 1.26), [1.4, 1.5, 1.6]])
    objects, _ = lifted([post, person(20, 2, 12)], box(20, 2))
    assert objects == [list(range(3, 15))]


def test_a_wall_far_behind_an_empty_box_is_too_high_for_a_person() -> None:
    objects, counts = lifted([wall(50)], box(20, 1))  # 1.8 m at 20 m is 4.5 m at 50 m
    assert objects == [] and counts == {"2D boxes of another height than people": 1}


def test_what_the_clustering_knows_is_taken_as_it_knows_it() -> None:
    cloud = [person(20, 1, 10), person(20, 1.6, 10), wall(40)]
    total = 20 + len(wall(40))
    known = np.full(total, -1)
    known[1:10], known[20:] = 4, 2  # all points of the first person but one, and the wall
    objects, _ = lifted(cloud, box(20, 1), given=(known,))
    assert objects == [list(range(1, 10))]
    # A cluster that reaches far out of the box is another object.
    known[:20] = 4
    objects, _ = lifted(cloud, box(20, 1), given=(known,))
    assert objects == [list(range(10))]


def test_two_boxes_of_one_person_are_one_object_the_better_box_first() -> None:
    cloud = [person(20, 1, 10)]
    objects, counts = lifted(cloud, box(20, 1, score=0.5), box(20, 1, score=0.9))
    assert objects == [list(range(10))]
    assert counts["2D boxes of an object of a better one"] == 1


def test_without_points_or_boxes_there_is_nothing() -> None:
    assert lifted([NONE], box(20, 1))[0] == []
    assert lifted([person(20, 1)])[0] == []
