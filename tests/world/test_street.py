"""The made-up drive keeps its protocol, and what it says of itself is true."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

import world
from upvl_cli.datasets.labels import LabelSource
from upvl_cli.errors import BadInput
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.geometry.iou import iou_bev
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Boxes, Dataset, Drive
from world.labels import StreetLabels
from world.layout import CAR, GROUND, vehicle
from world.scene import BOX, Motion, Part, Pose, Scene, Thing, solids_at
from world.sensors import RANGE_NOISE_M, sweep
from world.street import RATE_HZ, Streets

DIGEST = """
import hashlib
from world.street import Streets
from world.labels import StreetLabels
drive = Streets(frames=2, seeds=(7,)).open("street-7")
points, truth = drive.points(1), drive.truth(1)
labels = StreetLabels(frames=2, seeds=(7,)).labels("street-7")
arrays = points.xyz_ego_m, points.intensity, truth.velocity_mps, drive.image(1, "front").rgb, labels.to_rows()
print(hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest())
"""


def world_points(frame, thing):
    points, truth = world.sweep(frame)
    return apply(world.drive().world_from_ego[frame], points.xyz_ego_m[truth.object_index == thing])


def things_of(kind):
    return [number for number, thing in enumerate(world.drive().scene.things) if thing.kind == kind]


def box_of(scene, thing, time_s):
    x_m, y_m, heading_rad = thing.motion.at(time_s)
    length, width, height = thing.size_lwh_m
    z_m = float(scene.ground.height_m(x_m, y_m)) + height / 2
    return np.array([[x_m, y_m, z_m, length, width, height, heading_rad]])


def test_it_keeps_the_protocols():
    dataset: Dataset = Streets(frames=1)
    drive: Drive = dataset.open("street-0")
    labels: LabelSource = StreetLabels(frames=1)
    assert (drive.name, drive.files, dict(drive.skipped), drive.ground_z_m) == ("street-0", (), {}, 0.0)
    assert len(labels.labels(drive.name)) > 0


def test_segments_are_sorted_and_named_after_their_seeds():
    assert Streets(seeds=(3, 0, 12)).segments == ("street-0", "street-12", "street-3")
    assert Streets(seeds=()).segments == ()


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            lambda: Streets(seeds=(0, 4)).open("street-1"),
            "no segment 'street-1'; it has street-0, street-4",
        ),
        (lambda: StreetLabels().labels("../x"), "no segment '../x'; it has street-0"),
        (lambda: world.drive().points(6), "street-0 has no frame 6; it has the frames 0 to 5"),
        (lambda: world.drive().image(-1, "front"), "street-0 has no frame -1"),
        (lambda: world.drive().image(0, "rear"), "street-0 has no camera 'rear'; it has 'front'"),
        (lambda: Streets(frames=0), "a made-up street of 0 frames: expected 1 or more"),
        (lambda: Streets(seeds=(-1,)), "expected none below 0"),
    ],
)
def test_bad_input_is_one_clear_line(act, message):
    with pytest.raises(BadInput) as caught:
        act()
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_frames_come_ten_times_a_second():
    frames = world.drive().frames
    assert [frame.index for frame in frames] == list(range(world.FRAMES))
    assert np.diff([frame.time_ns for frame in frames]).tolist() == [100_000_000] * (world.FRAMES - 1)
    assert world.drive().world_from_ego.shape == (world.FRAMES, 4, 4)


def test_a_sweep_is_what_a_lidar_gives():
    points, _ = world.sweep(0)
    assert 20_000 < len(points) < 60_000
    assert np.isfinite(points.xyz_ego_m).all()
    assert 60 < np.linalg.norm(points.xyz_ego_m, axis=1).max() < 77
    assert points.intensity.min() >= 0 and 0.5 < points.intensity.max() <= 1
    assert points.elongation.min() >= 0 and points.elongation.max() > 0.1
    assert not points.sensor.any() and not points.time_offset_ns.any()


def test_the_ground_is_where_it_is_said_to_be_and_is_no_plane():
    points, truth = world.sweep(0)
    ground = world_points(0, -1)
    off_m = ground[:, 2] - GROUND.height_m(ground[:, 0], ground[:, 1])
    street = np.abs(ground[:, 1]) < 8  # noise that crosses the kerb is as high as the kerb
    assert np.quantile(np.abs(off_m[street]), 0.995) < 4 * RANGE_NOISE_M
    below = points.xyz_ego_m[(truth.object_index == -1) & (np.abs(points.xyz_ego_m[:, :2]).max(axis=1) < 5)]
    assert np.median(below[:, 2]) == pytest.approx(world.drive().ground_z_m, abs=0.05)
    near = ground[(np.abs(ground[:, 1]) < 8) & (np.abs(ground[:, 0]) < 40)]
    design = np.column_stack([near[:, :2], np.ones(len(near))])
    residual_m = near[:, 2] - design @ np.linalg.lstsq(design, near[:, 2], rcond=None)[0]
    assert residual_m.std() > 1.5 * RANGE_NOISE_M


def test_what_rests_stays_in_world_axes():
    solids = solids_at(world.drive().scene, 0.0)
    houses = [
        thing for thing in np.unique(solids.thing) if (solids.half_m[solids.thing == thing].max() > 5.0)
    ]
    compared = 0
    for thing in (house for house in houses if not world.drive().scene.things[house].kind):
        solid = solids[solids.thing == thing]
        for frame in (0, world.FRAMES - 1):
            points_m = world_points(frame, thing)
            outside_m = (np.abs(points_m - solid.centre_m) - solid.half_m).max(axis=1, initial=-9.0)
            assert (np.abs(outside_m) < 6 * RANGE_NOISE_M).all()
            compared += len(points_m)
    assert compared > 4000


def test_a_road_user_s_points_lie_in_its_box_now_and_moved_by_their_velocity_in_its_next_one():
    drive = world.drive()
    for frame in (0, 3):
        points, truth = world.sweep(frame)
        xyz_m = apply(drive.world_from_ego[frame], points.xyz_ego_m)
        way_m = truth.velocity_mps @ drive.world_from_ego[frame][:3, :3].T / RATE_HZ
        for number in np.unique(truth.object_index[truth.object_index >= 0]):
            thing = drive.scene.things[number]
            if not thing.kind:
                continue
            own = truth.object_index == number
            for place_m, time_s in ((xyz_m, frame / RATE_HZ), (xyz_m + way_m, (frame + 1) / RATE_HZ)):
                box = box_of(drive.scene, thing, time_s)
                assert points_inside(place_m[own], Boxes.from_rows(box), margin_m=4 * RANGE_NOISE_M).all()
                assert (
                    points_inside(place_m[own], Boxes.from_rows(box), margin_m=0.01).mean() > 0.85
                    or own.sum() < 20
                )


def test_the_front_of_the_truck_behind_fills_its_box_and_reaches_down_to_its_wheels():
    truck = things_of("Truck")[0]
    points_m = world_points(0, truck)
    box = box_of(world.drive().scene, world.drive().scene.things[truck], 0.0)[0]
    assert points_m[:, 0].max() == pytest.approx(box[0] + box[3] / 2, abs=0.1)
    assert np.ptp(points_m[:, 1]) == pytest.approx(box[4], abs=0.3)
    assert points_m[:, 2].min() < box[2] - box[5] / 2 + 0.5


def test_true_velocity_of_what_rests_is_zero_and_of_a_car_its_speed():
    points, truth = world.sweep(2)
    things = world.drive().scene.things
    speed_mps = np.linalg.norm(truth.velocity_mps, axis=1)
    rests = np.array([thing.motion.speed_mps == 0 for thing in things] + [True])[truth.object_index]
    assert (speed_mps[rests] == 0).all() and (speed_mps[~rests] > 0).all()
    for number in things_of("Truck") + things_of("Bus"):
        own = speed_mps[truth.object_index == number]
        motion = things[number].motion
        along_mps = motion.speed_mps - motion.brake_mps2 * 0.25  # half way between frames 2 and 3
        np.testing.assert_allclose(own, along_mps * np.hypot(1, GROUND.grade), rtol=1e-9)
    assert len(truth) == len(points)


def test_legs_of_a_walker_swing():
    _, truth = world.sweep(0)
    walking = [n for n in things_of("Pedestrian") if world.drive().scene.things[n].motion.speed_mps]
    speeds = [np.linalg.norm(truth.velocity_mps[truth.object_index == number], axis=1) for number in walking]
    assert max(np.ptp(speed) for speed in speeds if len(speed) > 20) > 0.3


@pytest.mark.parametrize("seed", range(6))
def test_nobody_drives_through_another(seed):
    drive = Streets(seeds=(seed,)).open(f"street-{seed}")
    users = [thing for thing in drive.scene.things if thing.kind]
    for frame in range(0, 80, 4):
        boxes = [box_of(drive.scene, thing, frame / RATE_HZ) for thing in users]
        x_m, y_m, heading_rad = drive.scene.ego.at(frame / RATE_HZ)
        all_rows = np.concatenate([*boxes, [[x_m, y_m, 0.8, 4.8, 1.9, 1.6, heading_rad]]])
        all_boxes = Boxes.from_rows(all_rows)
        assert not np.triu(iou_bev(all_boxes, all_boxes), k=1).any()


@pytest.mark.parametrize("seed", range(6))
def test_every_street_has_all_kinds_and_a_hidden_car(seed):
    drive = Streets(frames=1, seeds=(seed,)).open(f"street-{seed}")
    _, truth = drive.points_with_truth(0)
    count = np.bincount(truth.object_index + 1, minlength=len(drive.scene.things) + 1)[1:]
    seen = {thing.kind for thing, n in zip(drive.scene.things, count, strict=True) if n >= 5}
    assert seen == {"", "Car", "Truck", "Bus", "Pedestrian", "Cyclist"}
    hidden = [n for thing, n in zip(drive.scene.things, count, strict=True) if thing.motion.start.y_m == 22.0]
    assert hidden == [0]


def test_a_car_behind_a_wall_gives_no_points():
    here = Motion(Pose(0.0, 0.0, 0.0))
    car = vehicle("Car", (4.5, 1.8, 1.5), CAR, "red", Motion(Pose(0.0, 14.0, 0.0)))
    wall = Thing("", (0, 0, 0), here, (Part(BOX, (0.0, 6.0, 4.0), (30.0, 0.3, 10.0), "brick"),))
    for things, seen in (((car,), True), ((car, wall), False)):
        scene = Scene(GROUND, things, here)
        solids = solids_at(scene, 0.0)
        returns = sweep(scene.world_from(here, 0.0), solids, GROUND, np.random.default_rng(0))
        assert (solids.thing[returns.solid[returns.solid >= 0]] == 0).any() == seen


def test_the_picture_shows_a_red_car_where_the_lidar_saw_it():
    drive, camera = world.drive(), world.drive().cameras[0]
    rgb = drive.image(0, camera.name).rgb
    assert rgb.shape == (camera.height_px, camera.width_px, 3) and rgb.dtype == np.uint8
    car = next(
        n for n in things_of("Car") if "red" in {part.material for part in drive.scene.things[n].parts}
    )
    points, truth = world.sweep(0)
    xyz_m = apply(inverse(camera.ego_from_camera), points.xyz_ego_m[truth.object_index == car])
    u_px, v_px, _ = np.rint((xyz_m / xyz_m[:, 2:]) @ camera.intrinsic.T).astype(int).T
    red, green, _ = np.median(rgb[v_px, u_px], axis=0)
    assert len(xyz_m) > 30 and red > 2 * green
    sky, road = rgb[2, 240].astype(int), rgb[-3, 300].astype(int)
    assert sky[2] > sky[0] and np.ptp(road) < 20


def test_the_order_of_calls_changes_nothing():
    first, second = Streets(frames=3).open("street-0"), Streets(frames=3).open("street-0")
    forward = [first.points(frame).xyz_ego_m.tobytes() for frame in (0, 1, 2)]
    second.image(2, "front")
    assert [second.points(frame).xyz_ego_m.tobytes() for frame in (2, 0, 1)] == [forward[2], *forward[:2]]
    assert len(set(forward)) == 3


def test_the_same_seed_gives_the_same_bytes_in_every_process():
    digests = set()
    for threads in ("1", "2"):
        env = os.environ | {
            "OMP_NUM_THREADS": threads,
            "OPENBLAS_NUM_THREADS": threads,
            "PYTHONHASHSEED": threads,
        }
        made = subprocess.run(
            [sys.executable, "-c", DIGEST], env=env, capture_output=True, text=True, check=True
        )
        digests.add(made.stdout)
    assert len(digests) == 1
    assert len(digests.pop().strip()) == len(hashlib.sha256().hexdigest())


def test_another_seed_gives_another_street():
    one, other = (Streets(frames=1, seeds=(seed,)).open(f"street-{seed}").scene for seed in (0, 1))
    assert one.things != other.things
