"""The made-up city: it keeps its protocol, is the same each time, and what it says of itself is true."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from city_checks import flow_residual_m, projection
from upvl_cli.datasets.labels import LabelSource
from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.geometry.iou import iou_3d
from upvl_cli.synthetic.cameras import CAMERAS, tiles
from upvl_cli.synthetic.config import CityConfig
from upvl_cli.synthetic.dataset import City
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.kinds import KINDS
from upvl_cli.synthetic.labels import GROUND_NAMES, CityFlow, CityLabels, is_labelled
from upvl_cli.synthetic.piece import STUFF
from upvl_cli.types import Boxes, Dataset, Drive, Labels

SHIPPED = CityConfig(**tomllib.loads((Path(__file__).parents[2] / "stages" / "synthetic.toml").read_text()))
EXACT = replace(SHIPPED, frames=3, noise=0.0)


@cache
def city() -> City:
    return City(EXACT)


def drive() -> CityDrive:
    return city().open("train-000")


@cache
def labels() -> Labels:
    return CityLabels(city()).labels("train-000")


def test_it_keeps_the_protocols() -> None:
    dataset: Dataset = city()
    found: Drive = dataset.open("train-000")
    source: LabelSource = CityLabels(city())
    assert (found.name, found.files, dict(found.skipped)) == ("train-000", (), {})
    assert len(found.frames) == len(found.world_from_ego) == 3  # type: ignore[arg-type]
    assert source.frames("train-000").tolist() == [0, 1, 2]
    assert source.covers("train-000", np.zeros((2, 3))).all()


def test_its_drives_are_named_by_split() -> None:
    dataset = City(replace(EXACT, train=2, val=1, test=1))
    assert dataset.segments == ("test-000", "train-000", "train-001", "val-000")
    with pytest.raises(BadInput, match="no segment 'train-002'; it has test-000, train-000"):
        dataset.open("train-002")


def test_a_kind_that_is_none_is_refused() -> None:
    with pytest.raises(BadSetting, match="held_out has 'fire trucks', which is no kind .* 'fire truck'"):
        City(replace(EXACT, held_out=("fire trucks",)))


def test_held_out_kinds_are_in_other_splits_only() -> None:
    everything = tuple(name for name in KINDS if name not in ("sedan", "adult", "bollard", "cyclist"))
    dataset = City(replace(EXACT, val=1, held_out=everything))
    here, elsewhere = (
        {thing.kind.name for thing in dataset.open(name).scene.things} for name in ("train-000", "val-000")
    )
    assert here and not here & set(everything)
    assert elsewhere & set(everything)


def test_a_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    again, other = City(EXACT).open("train-000"), City(replace(EXACT, seed=1)).open("train-000")
    points = [one.points(1) for one in (drive(), again, other)]
    pictures = [one.image(1, "side-left").rgb for one in (drive(), again, other)]  # type: ignore[union-attr]
    assert points[0].xyz_ego_m.tobytes() == points[1].xyz_ego_m.tobytes() != points[2].xyz_ego_m.tobytes()
    assert points[0].time_offset_ns.tobytes() == points[1].time_offset_ns.tobytes()
    assert pictures[0].tobytes() == pictures[1].tobytes() != pictures[2].tobytes()


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
def test_points_fall_on_pixels_of_their_own_object(camera: object) -> None:
    found = projection(drive(), 1, camera)  # type: ignore[arg-type]
    assert found.points > 5000
    assert found.inner > 0.999
    assert found.silhouette > 0.98


def test_points_moved_by_their_flow_lie_on_their_object_in_the_next_sweep() -> None:
    off_m = flow_residual_m(drive(), 1)
    assert len(off_m) > 300
    assert np.quantile(off_m, 0.99) < 0.03


def test_what_stands_has_no_flow_at_all() -> None:
    _, truth = drive().points_with_truth(1)
    moves = np.array([thing.motion.moves for thing in drive().scene.things] + [False])[truth.thing]
    assert moves.sum() > 1000
    assert not truth.velocity_mps[~moves].any()
    speed = np.linalg.norm(truth.velocity_mps[moves], axis=1)
    assert 0.5 < np.median(speed) < 20


def test_limbs_move_otherwise_than_bodies() -> None:
    points, truth = drive().points_with_truth(1)
    spreads = [
        np.ptp(np.linalg.norm(truth.velocity_mps[truth.thing == number], axis=1))
        for number, thing in enumerate(drive().scene.things)
        if thing.kind.name == "adult" and thing.motion.moves and (truth.thing == number).sum() > 60
    ]
    assert spreads and max(spreads) > 0.5


def test_flow_knows_the_classes_of_its_points() -> None:
    flow = CityFlow(city()).flow("train-000", 1)
    _, truth = drive().points_with_truth(1)
    names = np.array(drive().scene.names)[truth.name]
    assert (flow.flow_class[np.isin(names, GROUND_NAMES)] == -1).all()
    assert (flow.flow_class[names == "building"] == 0).all()
    for kind in ("sedan", "hatchback", "suv"):
        assert (names == kind).any()
        assert (flow.flow_class[names == kind] == 1).all()
    assert (flow.flow_class[names == "articulated truck"] == 2).all()
    assert np.array_equal(flow.velocity_mps, truth.velocity_mps)


def test_boxes_hold_the_points_of_their_things() -> None:
    points, truth = drive().points_with_truth(2)
    found = labels()
    here = found[found.frame == 2]
    lost = total = 0
    # What moves is seen up to 50 ms before or after the frame's time.
    swept = Boxes(here.center_m, here.size_lwh_m + [1.6, 0.3, 0.1], here.heading_rad)
    for row, number in enumerate(here.object_id.astype(int)):
        mine = points.xyz_ego_m[(truth.thing == number) & (points.sensor == 0)]
        lost += int((~points_inside(mine, swept[[row]], margin_m=0.0)[0]).sum()) if len(mine) else 0
        total += len(mine)
    assert total > 5000
    assert lost < 0.01 * total


def test_no_box_stands_in_another() -> None:
    found = labels()
    here = Boxes(found.center_m, found.size_lwh_m, found.heading_rad)[found.frame == 0]
    overlap = iou_3d(here, here) - np.eye(len(here))
    assert overlap.max() < 0.02


def test_velocities_of_labels_are_what_they_move() -> None:
    found = labels()
    pose = drive().world_from_ego
    first, second = (found[found.frame == frame] for frame in (0, 1))
    assert (first.object_id == second.object_id).all()
    world = [
        boxes.center_m @ pose[frame, :3, :3].T + pose[frame, :3, 3]
        for frame, boxes in enumerate((first, second))
    ]
    moved = (world[1] - world[0]) * drive().rate_hz
    np.testing.assert_allclose(first.velocity_mps @ pose[0, :3, :3].T, moved, atol=0.05)


def test_only_road_users_are_labelled() -> None:
    assert set(labels().class_name) <= {name for name, kind in KINDS.items() if is_labelled(kind)}
    assert not is_labelled(KINDS["bench"]) and is_labelled(KINDS["dog"])


def test_things_are_seen_in_part_or_whole() -> None:
    seen = drive().visible(1)
    assert ((seen[~np.isnan(seen)] >= 0) & (seen[~np.isnan(seen)] <= 1)).all()
    assert (seen > 0.9).any() and (seen < 0.3).any()


def test_names_of_pixels_are_known() -> None:
    image, truth = drive().image_with_truth(0, "front")
    assert image.rgb.shape == (427, 640, 3) and truth.name.shape == (427, 640)
    names = set(np.array([*drive().scene.names, "sky"])[truth.name].ravel())
    assert {"road", "building"} <= names <= {*STUFF, *KINDS, "sky"}
    assert np.isinf(truth.range_m[truth.name == -1]).all()
    assert (truth.thing[truth.range_m > 250] == -1).all()


def test_pictures_are_taken_when_the_lidar_looks_that_way() -> None:
    times = {camera.name: drive().image(0, camera.name).time_ns for camera in CAMERAS}  # type: ignore[union-attr]
    start = drive().frames[0].time_ns
    assert times["front"] == start
    assert times["side-left"] - start == -25_000_000 and times["side-right"] - start == 25_000_000


def test_a_rolling_shutter_slants_what_moves() -> None:
    rolling = City(replace(EXACT, rolling_s=0.05)).open("train-000")
    still, slanted = (one.image(0, "side-left").rgb for one in (drive(), rolling))  # type: ignore[union-attr]
    assert still.shape == slanted.shape
    middle = still.shape[0] // 2
    changed = np.abs(still.astype(int) - slanted.astype(int)).mean(axis=(1, 2))
    assert changed[[0, -1]].mean() > changed[middle]


def test_an_empty_city_can_be_driven_through() -> None:
    lonely = City(replace(EXACT, frames=1, density=0.0)).open("train-000")
    assert len(lonely.scene.things) < 30
    assert len(lonely.points(0)) > 50_000


def test_bad_frames_and_cameras_are_refused() -> None:
    with pytest.raises(BadInput, match="train-000 has no frame 3; it has the frames 0 to 2"):
        drive().points(3)
    with pytest.raises(BadInput, match="no camera 'rear'; it has front, front-left"):
        drive().image(0, "rear")


def test_tiles_are_all_pixels_once() -> None:
    order, place = tiles(50, 37)
    assert (np.sort(order) == np.arange(50 * 37)).all()
    assert (order[place] == np.arange(50 * 37)).all()
