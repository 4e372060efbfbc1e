"""Clusters of known points become boxes around them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proposal_scene import (
    all_candidates,
    block,
    car,
    changed,
    proposals,
    spot,
    sweep,
)

from upvl_cli.config.toml import load
from upvl_cli.geometry.boxes import points_inside
from upvl_cli.perception.clustering import NOISE
from upvl_cli.stages.propose import ProposeConfig

FORWARD = (5.0, 0.0)


def test_a_car_gets_the_tightest_box_along_its_motion() -> None:
    found = proposals(sweep((car(10, 3), FORWARD)))
    assert len(found.boxes) == 1
    np.testing.assert_allclose(found.boxes.center_m[0], [10, 3, 0.75], atol=0.1)
    np.testing.assert_allclose(found.boxes.size_lwh_m[0, :2], [4, 2], atol=0.15)
    assert abs(found.boxes.heading_rad[0]) < 0.05
    np.testing.assert_allclose(found.velocity_mps[0], [5, 0, 0], atol=1e-6)
    assert found.num_points[0] == len(car(0, 0))


def test_an_empty_sweep() -> None:
    found = proposals(sweep())
    assert len(found.boxes) == 0
    assert found.velocity_mps.shape == (0, 3)
    assert found.box_of_point.shape == (0,)


def test_boxes_hold_the_points_that_are_theirs() -> None:
    found = proposals(
        sweep((car(10, 3), FORWARD), (spot(40, 9, points=3), FORWARD), (car(25, -3), (0.0, 7.0)))
    )
    assert found.num_points.tolist() == np.bincount(found.box_of_point[found.box_of_point >= 0]).tolist()
    xyz = np.concatenate([car(10, 3), spot(40, 9, points=3), car(25, -3)])
    box, inside = found.box_of_point, points_inside(xyz, found.boxes, margin_m=0.11)
    assert (box >= 0).sum() == 2 * len(car(0, 0))
    assert inside[box[box >= 0], np.flatnonzero(box >= 0)].all()


# Clustering.


def test_two_cars_that_pass_closely_are_two() -> None:
    found = proposals(sweep((car(10, 1.3), (8.0, 0.0)), (car(10, -1.3), (-8.0, 0.0))))
    assert len(found.boxes) == 2
    assert sorted(found.velocity_mps[:, 0]) == [-8.0, 8.0]


@pytest.mark.parametrize(
    ("distance_m", "difference_mps", "objects"),
    [
        (0.4, 0.0, 1),  # each alone is within the radius
        (0.0, 1.6, 1),
        (0.4, 1.6, 2),  # 0.8 and 0.8 of the radius: 1.13 together
        (0.3, 1.0, 1),  # 0.6 and 0.5: 0.78 together
        (0.6, 0.0, 2),
        (0.0, 2.4, 2),
    ],
)
def test_distance_and_difference_in_velocity_add_up_as_in_a_right_triangle(
    distance_m: float, difference_mps: float, objects: int
) -> None:
    pair = sweep((spot(8.05, 0.05), (6.0, 0.0)), (spot(8.05, 0.05 + distance_m), (6.0, difference_mps)))
    found = proposals(pair, clustering__eps_m=(0.5,), clustering__velocity_eps_mps=2.0)
    assert len(found.boxes) == objects


@pytest.mark.parametrize(("used", "objects"), [(True, 2), (False, 1)])
def test_velocity_counts_only_where_it_is_used(used: bool, objects: int) -> None:
    pair = sweep((spot(8.05, 0.05), (6.0, 0.0)), (spot(8.05, 0.35), (6.0, 9.0)))
    assert len(proposals(pair, clustering__eps_m=(0.5,), clustering__use_velocity=used).boxes) == objects


@pytest.mark.parametrize(
    ("eps_m", "vertical_eps_m", "gap_m", "objects"),
    [(0.6, 1.0, 0.9, 1), (0.6, 1.0, 1.1, 2), (0.6, 2.0, 1.9, 1), (1.5, 1.0, 1.4, 1)],
)
def test_up_and_down_neighbors_are_farther_apart(
    eps_m: float, vertical_eps_m: float, gap_m: float, objects: int
) -> None:
    pair = sweep((np.concatenate([spot(8.05, 0.05, 0.05), spot(8.05, 0.05, 0.05 + gap_m)]), FORWARD))
    found = proposals(
        pair, clustering__eps_m=(eps_m,), clustering__vertical_eps_m=vertical_eps_m, clustering__voxel_m=0.02
    )
    assert len(found.boxes) == objects


def test_a_roof_above_its_windows_is_of_the_same_car() -> None:
    body = car(10, 3)
    points = body[(body[:, 2] < 0.6) | (body[:, 2] > 1.2)]
    assert len(proposals(sweep((points, FORWARD)), clustering__eps_m=(0.6,)).boxes) == 1


@pytest.mark.parametrize(
    ("x_m", "y_m", "scaled", "degrees", "objects"),
    [
        (24.05, 32.05, True, 1.2, 1),  # 40 m away 1.2 degrees are 0.84 m
        (32.05, 24.05, True, 1.2, 1),
        (24.05, 0.05, True, 1.2, 2),
        (24.05, 32.05, False, 1.2, 2),
        (24.05, 32.05, True, 0.9, 2),
    ],
)
def test_far_away_neighbors_are_those_within_an_angle(
    x_m: float, y_m: float, scaled: bool, degrees: float, objects: int
) -> None:
    pair = sweep((spot(x_m, y_m), FORWARD), (spot(x_m, y_m + 0.7), FORWARD))
    found = proposals(
        pair,
        clustering__eps_m=(0.6,),
        clustering__scale_with_range=scaled,
        clustering__angular_eps_deg=degrees,
    )
    assert len(found.boxes) == objects


@pytest.mark.parametrize(
    ("used", "difference", "objects"), [(True, 0.45, 1), (True, 0.55, 2), (False, 0.55, 1), (True, 0.0, 1)]
)
def test_features_that_differ_part_two_objects_where_they_are_used(
    used: bool, difference: float, objects: int
) -> None:
    pair = sweep((spot(8.05, 0.05), FORWARD), (spot(8.05, 0.05), FORWARD))
    pair = replace(pair, vl_feature=np.repeat([[0.0, 0.0], [0.0, difference]], 6, axis=0))
    found = proposals(pair, clustering__use_vl=used, clustering__vl_eps=0.5, clustering__eps_m=(0.8,))
    assert len(found.boxes) == objects


def test_an_object_has_the_smallest_number_of_points() -> None:
    seen = sweep((spot(8.05, 0.05, points=6), FORWARD), (spot(18.05, 0.05, points=5), FORWARD))
    found = proposals(seen)
    assert found.num_points.tolist() == [6]
    assert found.box_of_point.tolist() == [0] * 6 + [NOISE] * 5
    assert found.dropped["points in no cluster"] == 5


# Background.


def test_background_is_dropped_by_its_share() -> None:
    seen = sweep((car(10, 3), FORWARD), (car(30, 3), FORWARD))
    half = len(seen.xyz_m) // 2
    walls = replace(seen, background=(np.arange(len(seen.xyz_m)) < half).astype(np.int8))
    kept = proposals(walls, background__max_share=0.9)
    assert kept.dropped["background"] == 1
    np.testing.assert_allclose(kept.boxes.center_m[:, 0], [30], atol=0.1)
    assert len(proposals(walls, background__max_share=1.0).boxes) == 2
    assert len(proposals(walls, background__max_share=0.5, background__drop=False).boxes) == 2


def test_a_share_at_the_limit_is_kept() -> None:
    seen = sweep((spot(8.05, 0.05, points=8), FORWARD))
    half = replace(seen, background=np.array([1, 0] * 4, np.int8))
    assert len(proposals(half, background__max_share=0.5).boxes) == 1
    assert len(proposals(half, background__max_share=0.49).boxes) == 0


def test_points_of_which_nothing_is_known_have_no_share() -> None:
    seen = sweep((car(10, 3), FORWARD))
    tenth = np.arange(len(seen.xyz_m)) % 10
    mostly_unknown = np.where(tenth == 0, 1, np.where(tenth == 1, 0, -1)).astype(np.int8)  # half of the known
    walls = replace(seen, background=mostly_unknown)
    assert len(proposals(walls, background__max_share=0.4).boxes) == 0
    assert len(proposals(walls, background__max_share=0.6).boxes) == 1
    unknown = replace(seen, background=np.full(len(tenth), -1, np.int8))
    for cluster in (True, False):
        assert len(proposals(unknown, background__max_share=0.0, background__cluster=cluster).boxes) == 1


def test_background_that_makes_no_cluster_joins_what_it_lies_in() -> None:
    seen = sweep((car(10, 3), FORWARD))
    side = seen.xyz_m[:, 0] > 9.0  # the side of the car is taken for a wall
    walls = replace(seen, background=side.astype(np.int8))
    kept = proposals(walls, background__cluster=False, background__max_share=1.0)
    assert len(kept.boxes) == 1
    assert kept.boxes.size_lwh_m[0, 0] < 1.5  # its back alone makes the box
    assert (proposals(walls, background__cluster=True).boxes.size_lwh_m[0, 0]) > 3.5


@pytest.mark.parametrize(("max_share", "drop", "objects"), [(0.3, True, 0), (0.3, False, 1), (0.6, True, 1)])
def test_background_that_joined_counts_for_the_share(max_share: float, drop: bool, objects: int) -> None:
    seen = sweep((car(10, 3), FORWARD))
    walls = replace(seen, background=(np.arange(len(seen.xyz_m)) % 2).astype(np.int8))  # half of the points
    found = proposals(
        walls, background__cluster=False, background__max_share=max_share, background__drop=drop
    )
    assert len(found.boxes) == objects
    assert found.dropped["background"] == 1 - objects


# Points without a cluster.


def test_points_that_flow_missed_join_the_box_they_lie_in() -> None:
    seen = sweep((car(10, 3), FORWARD))
    missed = np.arange(len(seen.xyz_m)) % 3 > 0  # most of them
    still = replace(seen, velocity_mps=np.where(missed[:, None], 0, seen.velocity_mps), is_candidate=~missed)
    found = proposals(still)
    assert (found.box_of_point == 0).all()
    np.testing.assert_allclose(found.velocity_mps, [[5, 0, 0]])  # those that joined have no say in the motion


@pytest.mark.parametrize("car_first", [True, False])
def test_a_point_in_two_boxes_joins_the_smaller_one(car_first: bool) -> None:
    walker = (
        block(10.5, 3.4, (0.4, 0.4, 1.4)),
        (0.0, -4.0),
    )  # inside the box around the back and side of the car
    objects = [(car(10, 3), FORWARD), walker]
    free = np.array([[10.5, 3.4, 1.0], [9.0, 3.5, 1.0], [10.5, 3.4, 1.2]])
    seen = sweep(*(objects if car_first else objects[::-1]), (free, (0.0, 0.0)))
    found = proposals(seen)
    lengths = found.boxes.size_lwh_m[:, 0]
    small, large = int(lengths.argmin()), int(lengths.argmax())
    assert found.box_of_point[-3:].tolist() == [small, large, small]
    # Points with a cluster stay: the car's side under the walker's box, and all others.
    assert found.num_points[small] == len(walker[0]) + 2


def test_points_of_an_object_stay_with_it_where_a_smaller_box_lies_in_its_own() -> None:
    large, small = block(10, 3, (4, 2, 1.4), step_m=0.15), block(10, 3, (0.5, 0.5, 1.4), step_m=0.25)
    found = proposals(sweep((large, FORWARD), (small, (0.0, -4.0))))
    assert found.num_points.tolist() == [len(large), len(small)]


@pytest.mark.parametrize(("outside_m", "joins"), [(0.05, True), (0.15, False)])
def test_a_point_just_outside_a_box_joins_it(outside_m: float, joins: bool) -> None:
    solid = block(10, 3, (4, 2, 1.5), step_m=0.25)
    free = np.array([[12 + outside_m, 3, 1.0]])
    found = proposals(sweep((solid, FORWARD), (free, (0.0, 0.0))), box__trim=0.0)
    assert (found.box_of_point[-1] == 0) == joins
    farther = proposals(
        sweep((solid, FORWARD), (free, (0.0, 0.0))), box__trim=0.0, box__adoption_margin_m=0.2
    )
    assert farther.box_of_point[-1] == 0


# Crowds.


def test_a_crowd_becomes_its_persons_and_their_numbers_stay_apart() -> None:
    three = [block(10 + 0.8 * k, 3, (0.5, 0.5, 1.7), step_m=0.15) for k in range(3)]
    two = [block(20 + 0.8 * k, -3, (0.5, 0.5, 1.7), step_m=0.15) for k in range(2)]
    seen = sweep((np.concatenate(three), (1.5, 0.0)), (np.concatenate(two), (1.5, 0.0)))
    found = proposals(seen)
    assert len(found.boxes) == 5
    is_body = seen.height_m >= 0.3  # feet stay with the first person
    centers = found.boxes.center_m[found.box_of_point]
    owners = np.repeat([10, 10.8, 11.6, 20, 20.8], len(three[0]))
    np.testing.assert_allclose(centers[is_body, 0], owners[is_body], atol=0.05)


def test_what_lies_on_the_ground_joins_no_persons_to_one() -> None:
    persons = [block(10 + 0.8 * k, 3, (0.5, 0.5, 1.7)) for k in range(2)]
    strip = block(10.4, 3, (1.5, 0.5, 0.2), step_m=0.05)  # a kerb below both
    assert len(proposals(sweep((np.concatenate([*persons, strip]), (1.5, 0.0)))).boxes) == 2


# The box.


def test_a_fast_object_heads_along_its_motion() -> None:
    found = proposals(sweep((car(10, 3), (-3.0, 4.0))))
    assert found.boxes.heading_rad[0] == pytest.approx(np.arctan2(4, -3))


@pytest.mark.parametrize(("speed_mps", "by_motion"), [(1.0, True), (0.99, False)])
def test_below_a_speed_the_shape_gives_the_heading(speed_mps: float, by_motion: bool) -> None:
    seen = all_candidates(sweep((car(10, 3, heading_rad=0.5), (0.0, speed_mps))))
    heading = proposals(seen).boxes.heading_rad[0]
    assert heading == pytest.approx(np.pi / 2 if by_motion else 0.5, abs=0.02)


def test_speed_up_and_down_is_no_motion() -> None:
    seen = all_candidates(sweep((car(10, 3, heading_rad=0.5), (0.0, 0.5, 4.0))))
    assert proposals(seen).boxes.heading_rad[0] == pytest.approx(0.5, abs=0.02)


def test_stray_points_do_not_stretch_a_box() -> None:
    stray = np.array([[8.0, 4.8, 1.0]])
    points = np.concatenate([car(10, 3), stray])
    wide = proposals(sweep((points, FORWARD)), box__trim=0.0).boxes.size_lwh_m[0, 1]
    trimmed = proposals(sweep((points, FORWARD)), box__trim=0.01).boxes.size_lwh_m[0, 1]
    assert wide == pytest.approx(2.8)
    assert trimmed <= 2.0 + 1e-9


def test_points_near_the_ground_do_not_count_for_length_and_width() -> None:
    solid = block(10, 3, (4, 2, 1.5), step_m=0.25)
    kerb = block(10, 4.2, (4, 0.6, 0.29), step_m=0.145)
    found = proposals(sweep((np.concatenate([solid, kerb]), FORWARD)), box__trim=0.0)
    np.testing.assert_allclose(found.boxes.size_lwh_m, [[4, 2, 1.5]])
    seen = sweep((np.concatenate([solid, kerb]), FORWARD))
    assert proposals(seen, box__trim=0.0, box__ground_clearance_m=0.145).boxes.size_lwh_m[0, 1] > 2.4


def test_points_near_the_ground_do_not_count_for_the_heading() -> None:
    kerb = np.column_stack([np.linspace(7, 13, 400), np.full(400, 3.0), np.full(400, 0.1)])
    points = np.concatenate([car(10, 3, heading_rad=0.5), kerb])
    found = proposals(all_candidates(sweep((points, (0.0, 0.0)))))
    assert found.boxes.heading_rad[0] == pytest.approx(0.5, abs=0.02)


def test_a_point_at_the_ground_clearance_counts() -> None:
    low = np.array([[9.0, 3.0, 0.3], [11.0, 3.0, 0.3]])
    solid = block(10, 3, (1, 1, 1), step_m=0.25)
    found = proposals(sweep((np.concatenate([solid, low]), FORWARD)), box__trim=0.0)
    assert found.boxes.size_lwh_m[0, 0] == pytest.approx(2.0)


def test_an_object_all_near_the_ground_has_its_own_size() -> None:
    found = proposals(sweep((block(10, 3, (1, 0.5, 0.2)), FORWARD)), box__trim=0.0)
    np.testing.assert_allclose(found.boxes.size_lwh_m, [[1, 0.5, 0.2]])


@pytest.mark.parametrize(("lowest_m", "bottom_m"), [(0.6, 0.0), (1.49, 0.0), (1.5, 1.5), (1.6, 1.6)])
def test_a_box_reaches_down_to_the_ground_unless_the_object_hangs(lowest_m: float, bottom_m: float) -> None:
    ground_m = -1.7  # in the axes of the points
    points = block(10, 3, (1, 1, 1)) + [0, 0, lowest_m]
    seen = replace(sweep((points + [0, 0, ground_m], FORWARD)), height_m=points[:, 2])
    found = proposals(seen)
    bottom = found.boxes.center_m[0, 2] - found.boxes.size_lwh_m[0, 2] / 2
    top = found.boxes.center_m[0, 2] + found.boxes.size_lwh_m[0, 2] / 2
    assert bottom == pytest.approx(ground_m + bottom_m)
    assert top == pytest.approx(ground_m + lowest_m + 1)


def test_the_ground_of_a_box_is_the_median_of_that_below_its_points() -> None:
    points = block(10, 3, (1, 1, 1.4))
    height = points[:, 2] - 0.2
    height[:3] = 0.9  # three points have lost the ground
    found = proposals(replace(sweep((points, FORWARD)), height_m=height))
    assert found.boxes.center_m[0, 2] - found.boxes.size_lwh_m[0, 2] / 2 == pytest.approx(0.2)


def test_what_ships_is_what_the_settings_say() -> None:
    """The values of the algorithm stand in the TOML file alone: each is read by its own name."""
    config = load(ProposeConfig, Path(__file__).parents[3] / "stages" / "propose.toml")
    assert config.crowd == changed().crowd
    assert config.persistence == changed().persistence
    assert config.box == changed().box
