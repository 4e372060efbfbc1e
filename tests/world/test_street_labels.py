"""Labels of the made-up drive are exact."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np

import world
from upvl_cli.geometry.se3 import apply
from world import street
from world.labels import StreetLabels
from world.street import RATE_HZ


def count_inside(xyz_m, box):
    """Count the points in one box, by the angles and sides of the box alone."""
    (length, width, height), heading = box.size_lwh_m[0], box.heading_rad[0]
    x, y, z = (xyz_m - box.center_m[0]).T
    along = np.cos(heading) * x + np.sin(heading) * y
    across = np.cos(heading) * y - np.sin(heading) * x
    inside = (abs(along) <= length / 2) & (abs(across) <= width / 2) & (abs(z) <= height / 2)
    return int(inside.sum())


def test_point_counts_are_exact():
    labels = world.labels()
    for frame in range(world.FRAMES):
        xyz_m = world.sweep(frame)[0].xyz_ego_m.astype(np.float64)
        now = labels[labels.frame == frame]
        assert [count_inside(xyz_m, now[[row]]) for row in range(len(now))] == now.num_points.tolist()
    assert labels.num_points.max() > 1000


def test_every_labelled_object_was_seen_and_all_seen_ones_are_labelled():
    things = world.drive().scene.things
    seen = {
        int(thing)
        for frame in range(world.FRAMES)
        for thing in np.unique(world.sweep(frame)[1].object_index)
        if thing >= 0 and things[thing].kind
    }
    labels = world.labels()
    assert {int(each) for each in labels.object_id} == seen
    assert {things[int(each)].kind for each in labels.object_id} == {
        "Car",
        "Truck",
        "Bus",
        "Pedestrian",
        "Cyclist",
    }
    assert len(labels) == len(seen) * world.FRAMES


def test_a_box_holds_nearly_all_points_of_its_object():
    labels = world.labels()
    held = 0
    for frame in range(world.FRAMES):
        points, truth = world.sweep(frame)
        now = labels[labels.frame == frame]
        for row, (thing, count) in enumerate(zip(now.object_id, now.num_points, strict=True)):
            own = points.xyz_ego_m[truth.object_index == int(thing)]
            assert count >= 0.9 * len(own) - 2
            held += count_inside(own, now[[row]])
    total = sum(
        np.isin(world.sweep(f)[1].object_index, labels.object_id.astype(int)).sum()
        for f in range(world.FRAMES)
    )
    assert held > 0.98 * total


def test_velocity_is_the_way_to_the_next_box():
    labels, poses = world.labels(), world.drive().world_from_ego
    for frame in range(world.FRAMES - 1):
        now, later = labels[labels.frame == frame], labels[labels.frame == frame + 1]
        np.testing.assert_array_equal(now.object_id, later.object_id)
        way_m = apply(poses[frame + 1], later.center_m) - apply(poses[frame], now.center_m)
        np.testing.assert_allclose(now.velocity_mps @ poses[frame][:3, :3].T, way_m * RATE_HZ, atol=1e-9)
        np.testing.assert_array_equal(now.size_lwh_m, later.size_lwh_m)


def test_parked_cars_have_no_velocity_and_moving_ones_look_where_they_go():
    labels = world.labels()
    things = world.drive().scene.things
    moving = np.array([things[int(each)].motion.speed_mps > 0 for each in labels.object_id])
    assert (labels.velocity_mps[~moving] == 0).all() and (~moving).sum() > 50
    direction = np.arctan2(labels.velocity_mps[moving, 1], labels.velocity_mps[moving, 0])
    assert np.abs(np.angle(np.exp(1j * (direction - labels.heading_rad[moving])))).max() < 0.02
    assert np.linalg.norm(labels.velocity_mps[moving], axis=1).min() > 1.0


def test_boxes_stand_on_the_ground():
    labels, drive = world.labels(), world.drive()
    for frame in range(world.FRAMES):
        now = labels[labels.frame == frame]
        x_m, y_m, z_m = apply(drive.world_from_ego[frame], now.center_m).T
        height_m = drive.scene.ground.height_m(x_m, y_m)
        np.testing.assert_allclose(z_m - now.size_lwh_m[:, 2] / 2, height_m, atol=1e-9)


def test_difficulty_and_type_are_waymo_s():
    labels = world.labels()
    np.testing.assert_array_equal(labels.difficulty == 2, labels.num_points <= 5)
    number = {"Car": 1, "Truck": 1, "Bus": 1, "Pedestrian": 2, "Cyclist": 4}
    assert labels.type.tolist() == [number[kind] for kind in labels.class_name]


def test_every_place_is_covered():
    covers = StreetLabels(frames=1).covers
    assert covers("street-0", np.zeros((3, 3))).tolist() == [True] * 3
    assert covers("street-0", np.zeros((0, 3))).shape == (0,)


def test_the_drive_cannot_reach_its_labels():
    folder = Path(street.__file__).parent
    for path in folder.glob("street*.py"):
        if path.stem != "street_labels":
            modules = [
                node.module
                for node in ast.walk(ast.parse(path.read_text()))
                if isinstance(node, ast.ImportFrom)
            ]
            assert not any("labels" in module for module in modules if module)
