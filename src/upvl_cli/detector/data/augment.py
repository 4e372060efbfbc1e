"""Scenes as they could have been as well: mirrored, turned, of another size, with objects of other scenes."""

from __future__ import annotations

import numpy as np

from upvl_cli.detector.sweeps import Scene
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.geometry.se3 import wrap_angle
from upvl_cli.types import Array, Floats, Ints

# Those of SECOND (Yan et al., Sensors 2018) and of the detectors after it.
_TURN_RAD = np.pi / 4
_SCALE = 0.05


def augmented(scene: Scene, donor: Scene, rng: np.random.Generator, *, paste: int) -> Scene:
    """Return a scene changed by chance.

    Args:
        scene: What is changed.
        donor: Whose objects are set into it.
        rng: Chance.
        paste: How many objects of the donor are tried.
    """
    scene = pasted(scene, donor, rng.permutation(len(donor.boxes))[:paste])
    mirrored = bool(rng.random() < 0.5)
    return moved(scene, mirrored, rng.uniform(-_TURN_RAD, _TURN_RAD), rng.uniform(1 - _SCALE, 1 + _SCALE))


def moved(scene: Scene, mirrored: bool, turn_rad: float, scale: float) -> Scene:
    """Return the scene mirrored left to right, then turned about z, then scaled."""
    points, boxes = scene.points.copy(), scene.boxes.copy()
    velocity_mps = scene.velocity_mps.copy()
    if mirrored:
        for y in (points[:, 1], boxes[:, 1], boxes[:, 6], velocity_mps[:, 1]):
            np.negative(y, out=y)
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, sin], [-sin, cos]])  # for rows, from the right
    for xy in (points[:, :2], boxes[:, :2], velocity_mps[:, :2]):
        xy[:] = xy @ turn
    boxes[:, 6] = wrap_angle(boxes[:, 6] + turn_rad)
    points[:, :3] *= scale
    boxes[:, :6] *= scale
    return Scene(points, scene.code_of, scene.codes, boxes, velocity_mps * scale)


def pasted(scene: Scene, donor: Scene, chosen: Array) -> Scene:
    """Return the scene with objects of another one at the places they have there, where there is room.

    Points of the scene inside of a new object give way. An object takes along its points of the older sweep:
    those in its box where it was then.

    Args:
        scene: What is added to.
        donor: Where the objects are from.
        chosen: The boxes of the donor to try, in this order.
    """
    boxes = scene.boxes
    taken: list[int] = []
    points: list[Ints] = []
    for number in chosen.tolist():
        if iou_bev(donor.boxes[number : number + 1], boxes).any():
            continue
        held = _held(donor, number)
        if len(held):
            taken.append(number)
            points.append(held)
            boxes = np.concatenate([boxes, donor.boxes[number : number + 1]])
    if not taken:
        return scene
    new = np.unique(np.concatenate(points))
    room = ~points_inside(scene.points[:, :3], donor.boxes[taken], margin_m=0.0).any(axis=0)
    code_of = donor.code_of[new]
    code_of = np.where(code_of >= 0, code_of + len(scene.codes), -1)
    return Scene(
        np.concatenate([scene.points[room], donor.points[new]]),
        np.concatenate([scene.code_of[room], code_of]).astype(np.int32),
        np.concatenate([scene.codes, donor.codes]),
        boxes,
        np.concatenate([scene.velocity_mps, donor.velocity_mps[taken]]),
    )


def _held(scene: Scene, number: int) -> Ints:
    """Return which points a box holds, each sweep's at the place that the box had at its time."""
    box: Floats = scene.boxes[number]
    velocity_mps = scene.velocity_mps[number]
    reach = np.hypot(box[3], box[4]) / 2 - np.hypot(*velocity_mps[:2]) * scene.points[:, 5].min(initial=0)
    near = np.flatnonzero(
        (np.abs(scene.points[:, 0] - box[0]) <= reach) & (np.abs(scene.points[:, 1] - box[1]) <= reach)
    )
    points = scene.points[near]
    # In the axes of the box as it moves: the points are brought to the time of this sweep.
    xyz_m = points[:, :3] - points[:, 5:] * velocity_mps
    return np.asarray(near[points_inside(xyz_m, box[None], margin_m=0.0)[0]])
