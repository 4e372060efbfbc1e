"""Random changes of training frames: mirrored, turned, scaled, with pasted objects of other frames.

Those of SECOND (Yan et al., Sensors 2018, Section 3.4) and of the detectors after it.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.detector.config import AugmentationConfig
from upvl_cli.detector.data.batch import TIME_DIM
from upvl_cli.detector.data.scene import TrainingScene
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.types import Array, Boxes, Ints, concat


def augment(
    scene: TrainingScene, donor: TrainingScene, config: AugmentationConfig, rng: np.random.Generator
) -> TrainingScene:
    """Return a scene changed at random.

    Args:
        scene: The scene to change.
        donor: The scene whose objects are pasted into it.
        config: How much it changes.
        rng: Random numbers.
    """
    scene = paste_objects(scene, donor, rng.permutation(len(donor.boxes))[: config.pasted_objects])
    is_mirrored = bool(rng.random() < config.mirror_probability)
    turn_rad = rng.uniform(-config.max_turn_rad, config.max_turn_rad)
    return move_scene(
        scene, is_mirrored, turn_rad, rng.uniform(1 - config.scale_jitter, 1 + config.scale_jitter)
    )


def move_scene(scene: TrainingScene, is_mirrored: bool, turn_rad: float, scale: float) -> TrainingScene:
    """Return the scene mirrored left to right, then turned about z, then scaled."""
    points, velocity_mps = scene.points.copy(), scene.velocity_mps.copy()
    center_m, heading_rad = scene.boxes.center_m.copy(), scene.boxes.heading_rad.copy()
    if is_mirrored:
        for y in (points[:, 1], center_m[:, 1], heading_rad, velocity_mps[:, 1]):
            np.negative(y, out=y)
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, sin], [-sin, cos]])  # of row vectors, from the right
    for xy in (points[:, :2], center_m[:, :2], velocity_mps[:, :2]):
        xy[:] = xy @ turn
    points[:, :3] *= scale
    boxes = Boxes(center_m * scale, scene.boxes.size_lwh_m * scale, wrap_angle(heading_rad + turn_rad))
    return TrainingScene(points, scene.code_of, scene.codes, boxes, velocity_mps * scale)


def paste_objects(scene: TrainingScene, donor: TrainingScene, chosen: Array) -> TrainingScene:
    """Return the scene with objects of another one, at the places that they have there, where these are free.

    Points of the scene inside of a new object are removed. An object takes along its points of the older sweep:
    those in its box where it was then.

    Args:
        scene: The scene to add to.
        donor: The scene that the objects are from.
        chosen: The boxes of the donor to try, in this order.
    """
    boxes = scene.boxes
    pasted: list[int] = []
    points: list[Ints] = []
    for number in chosen.tolist():
        candidate = donor.boxes[number : number + 1]
        if iou_bev(candidate, boxes).any():
            continue
        of_object = _points_of_object(donor, number)
        if len(of_object):
            pasted.append(number)
            points.append(of_object)
            boxes = concat([boxes, candidate], Boxes)
    if not pasted:
        return scene
    new = np.unique(np.concatenate(points))
    stays = ~points_inside(scene.points[:, :3], donor.boxes[pasted], margin_m=0.0).any(axis=0)
    code_of = donor.code_of[new]
    code_of = np.where(code_of >= 0, code_of + len(scene.codes), -1)
    return TrainingScene(
        np.concatenate([scene.points[stays], donor.points[new]]),
        np.concatenate([scene.code_of[stays], code_of]).astype(np.int32),
        np.concatenate([scene.codes, donor.codes]),
        boxes,
        np.concatenate([scene.velocity_mps, donor.velocity_mps[pasted]]),
    )


def _points_of_object(scene: TrainingScene, number: int) -> Ints:
    """Return the points in a box, those of the older sweep where the box was at their time."""
    box, velocity_mps = scene.boxes[number : number + 1], scene.velocity_mps[number]
    ((x, y, _),), ((length, width, _),) = box.center_m, box.size_lwh_m
    times_s = scene.points[:, TIME_DIM]
    reach = np.hypot(length, width) / 2 - np.hypot(*velocity_mps[:2]) * times_s.min(initial=0)
    near = np.flatnonzero(
        (np.abs(scene.points[:, 0] - x) <= reach) & (np.abs(scene.points[:, 1] - y) <= reach)
    )
    points = scene.points[near]
    # The points are brought to the time of this sweep with the velocity of the box.
    xyz_m = points[:, :3] - points[:, TIME_DIM:] * velocity_mps
    return np.asarray(near[points_inside(xyz_m, box, margin_m=0.0)[0]])
