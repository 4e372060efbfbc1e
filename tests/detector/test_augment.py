"""Scenes that could have been: boxes keep their points, whatever is done."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import SHIPPED, shifted

from upvl_cli.detector.config import AugmentationConfig
from upvl_cli.detector.data.augment import augment, move_scene, paste_objects
from upvl_cli.detector.data.scene import TrainingScene
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.types import Boxes, concat, empty

BOX = Boxes.from_rows(np.array([[10.0, 4, 1, 4, 2, 1.6, 0.5]]))


def filled(boxes: Boxes, velocity_mps: np.ndarray, mark: int, each: int = 50) -> TrainingScene:
    """Boxes with points of two sweeps in each, and as many points beside of them."""
    rng = np.random.default_rng(mark)
    cos, sin = np.cos(boxes.heading_rad), np.sin(boxes.heading_rad)
    points = []
    for time_s in (0.0, -0.1):
        own = rng.uniform(-0.45, 0.45, (len(boxes), each, 3)) * boxes.size_lwh_m[:, None]
        x = own[..., 0] * cos[:, None] - own[..., 1] * sin[:, None]
        y = own[..., 0] * sin[:, None] + own[..., 1] * cos[:, None]
        xyz = np.stack([x, y, own[..., 2]], axis=-1) + (
            boxes.center_m[:, None] + time_s * velocity_mps[:, None]
        )
        far = rng.uniform([30, 15, 0], [40, 20, 2], (each, 3))
        xyz = np.concatenate([xyz.reshape(-1, 3), far])
        points.append(np.column_stack([xyz, np.full((len(xyz), 2), 0.5), np.full(len(xyz), time_s)]))
    whole = np.concatenate(points).astype(np.float32)
    codes = np.full((len(points[0]), 64), mark, np.int8)
    code_of = np.concatenate([np.arange(len(points[0])), np.full(len(points[1]), -1)]).astype(np.int32)
    return TrainingScene(whole, code_of, codes, boxes, velocity_mps)


STILL = np.zeros((1, 3))
FAST = np.array([[20.0, 5, 0]])


def held(scene: TrainingScene, number: int = 0) -> np.ndarray:
    """The points in a box, those of the older sweep where it was then."""
    xyz = scene.points[:, :3] - scene.points[:, 5:] * scene.velocity_mps[number]
    return points_inside(xyz, scene.boxes[number : number + 1], margin_m=0.001)[0]


@pytest.mark.parametrize(
    ("mirrored", "turn_rad", "scale"),
    [(True, 0.0, 1.0), (False, 0.7, 1.0), (False, 0.0, 1.05), (True, -0.7, 0.95)],
)
def test_a_box_keeps_its_points_and_its_way(mirrored: bool, turn_rad: float, scale: float) -> None:
    before = filled(BOX, FAST, 1)
    after = move_scene(before, mirrored, turn_rad, scale)
    np.testing.assert_array_equal(held(before), held(after))
    assert held(after).sum() == 100
    np.testing.assert_allclose(after.boxes.size_lwh_m, BOX.size_lwh_m * scale)
    np.testing.assert_allclose(np.linalg.norm(after.velocity_mps), np.linalg.norm(FAST) * scale)
    np.testing.assert_array_equal(before.boxes.to_rows(), BOX.to_rows())  # a scene is never changed in place


def test_a_mirror_and_a_turn_by_hand() -> None:
    one = filled(BOX, FAST, 1)
    np.testing.assert_allclose(
        move_scene(one, True, 0.0, 1.0).boxes.to_rows()[0], [10, -4, 1, 4, 2, 1.6, -0.5]
    )
    np.testing.assert_allclose(
        move_scene(one, False, np.pi / 2, 1.0).boxes.to_rows()[0, [0, 1, 6]], [-4, 10, 0.5 + np.pi / 2]
    )


def test_an_object_comes_with_its_points_of_both_sweeps_and_their_features() -> None:
    scene, donor = filled(BOX, STILL, 1), filled(shifted(BOX, y=-10), FAST, 2)
    after = paste_objects(scene, donor, np.array([0]))
    assert len(after.boxes) == 2
    new = held(after, 1)
    assert new.sum() == 100
    assert (after.codes[after.code_of[new & (after.code_of >= 0)]] == 2).all()
    assert (new & (after.code_of >= 0)).sum() == 50
    assert held(after, 0).sum() == 100
    assert (after.codes[after.code_of[held(after, 0) & (after.code_of >= 0)]] == 1).all()


def test_nothing_is_set_where_something_is() -> None:
    scene = filled(BOX, STILL, 1)
    assert paste_objects(scene, filled(shifted(BOX, x=1), STILL, 2), np.array([0])) is scene
    nothing = TrainingScene(
        np.zeros((0, 6), np.float32),
        np.zeros(0, np.int32),
        np.zeros((0, 64), np.int8),
        shifted(BOX, x=10),
        FAST,
    )
    assert paste_objects(scene, nothing, np.array([0])) is scene  # an object without points is none


def test_what_was_there_gives_way() -> None:
    scene = filled(BOX, STILL, 1)
    bare = TrainingScene(scene.points, scene.code_of, scene.codes, empty(Boxes), np.zeros((0, 3)))
    after = paste_objects(bare, filled(BOX, STILL, 2), np.array([0]))
    assert held(after).sum() == 100
    assert len(after.points) == len(scene.points)


def test_chance_is_that_of_the_generator() -> None:
    scene, donor = filled(BOX, STILL, 1), filled(shifted(BOX, y=-10), FAST, 2)
    once = replace(SHIPPED.augmentation, pasted_objects=1)
    one, same, other = (augment(scene, donor, once, np.random.default_rng(s)) for s in (5, 5, 6))
    np.testing.assert_array_equal(one.points, same.points)
    assert abs(one.boxes.to_rows()[0] - other.boxes.to_rows()[0]).max() > 0.01
    assert len(one.boxes) == 2


def test_chances_and_ranges_are_those_of_the_settings() -> None:
    scene = filled(BOX, FAST, 1)
    fixed = AugmentationConfig(mirror_probability=1.0, max_turn_rad=0.0, scale_jitter=0.0, pasted_objects=0)
    always = augment(scene, scene, fixed, np.random.default_rng(0))
    np.testing.assert_allclose(always.boxes.to_rows(), move_scene(scene, True, 0.0, 1.0).boxes.to_rows())
    never = augment(scene, scene, replace(fixed, mirror_probability=0.0), np.random.default_rng(0))
    np.testing.assert_allclose(never.boxes.to_rows(), BOX.to_rows())
    turning = replace(fixed, mirror_probability=0.0, max_turn_rad=0.2)
    scaling = replace(fixed, mirror_probability=0.0, scale_jitter=0.1)
    turn, scale = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        turn.append(augment(scene, scene, turning, rng).boxes.heading_rad[0] - 0.5)
        scale.append(augment(scene, scene, scaling, rng).boxes.size_lwh_m[0, 0] / 4)
    assert -0.2 <= min(turn) < -0.15 and 0.15 < max(turn) <= 0.2
    assert 0.9 <= min(scale) < 0.92 and 1.08 < max(scale) <= 1.1


def test_as_many_objects_are_pasted_as_the_settings_say() -> None:
    many = concat([shifted(BOX, y=-10), shifted(BOX, x=10), shifted(BOX, x=10, y=-10)], Boxes)
    scene, donor = filled(BOX, STILL, 1), filled(many, np.zeros((3, 3)), 2)
    for count in (0, 2, 3):
        config = replace(SHIPPED.augmentation, pasted_objects=count)
        assert len(augment(scene, donor, config, np.random.default_rng(0)).boxes) == 1 + count


def test_two_pasted_objects_do_not_overlap() -> None:
    pair = concat([shifted(BOX, y=-10), shifted(BOX, x=1, y=-10)], Boxes)
    scene, donor = filled(BOX, STILL, 1), filled(pair, np.zeros((2, 3)), 2)
    after = paste_objects(scene, donor, np.array([1, 0]))
    assert len(after.boxes) == len(after.velocity_mps) == 2
    np.testing.assert_array_equal(after.boxes.center_m[1], pair.center_m[1])
