"""Agreement of two sweeps, the search of their motion, and what counts as upright."""

from __future__ import annotations

import numpy as np
import pytest

from perception.still_scene import LIDAR, gentle_bend, points_at, prepared
from upvl_cli.geometry.se3 import from_yaw, inverse
from upvl_cli.perception.odometry.agreement import Structure, align_structure, measure_agreement
from upvl_cli.perception.odometry.motion_search import Reach, search_motion
from upvl_cli.perception.odometry.sweep import find_upright, first_in_voxels

MOTION = gentle_bend(20.0)(0.2)  # 4 m and 0.02 rad
TARGET, SOURCE = (
    prepared(points_at(pose, seed), 0.0).structure.xyz_m for seed, pose in enumerate((np.eye(4), MOTION))
)


def test_the_true_motion_agrees_best() -> None:
    target, source = Structure(TARGET), Structure(SOURCE)
    true, stands, back = (
        measure_agreement(target, source, motion, LIDAR.agreement)
        for motion in (MOTION, np.eye(4), inverse(MOTION))
    )
    assert true.inlier_share > 0.85 > 0.7 > max(stands.inlier_share, back.inlier_share)
    assert true.rmse_m() < 0.1
    radius_m = LIDAR.agreement.partner_m
    assert true.error_m2(radius_m) < 0.3 * min(stands.error_m2(radius_m), back.error_m2(radius_m))


def test_the_model_foretells_the_residual_of_a_small_motion() -> None:
    target, source = Structure(TARGET), Structure(SOURCE)
    step = np.array([0.03, -0.04, 0.001])
    moved = from_yaw(step[2], np.array([*step[:2], 0.0])) @ MOTION
    model = measure_agreement(target, source, MOTION, LIDAR.agreement).rmse_m(step)
    assert model == pytest.approx(
        measure_agreement(target, source, moved, LIDAR.agreement).rmse_m(), rel=0.05
    )


def test_a_wall_alone_leaves_the_way_along_it_open() -> None:
    rng = np.random.default_rng(0)
    wall = np.column_stack(
        [rng.uniform(-30, 30, 4000), 5 + rng.normal(0, 0.01, 4000), rng.uniform(0, 3, 4000)]
    )
    along, heading = measure_agreement(
        Structure(wall[::2]), Structure(wall[1::2]), np.eye(4), LIDAR.agreement
    ).sigmas
    assert along > 0.1
    assert heading < 0.01
    fixed, _ = measure_agreement(Structure(TARGET), Structure(SOURCE), MOTION, LIDAR.agreement).sigmas
    assert fixed < 0.02


def test_alignment_brings_a_guess_to_the_true_motion_as_far_as_the_guess_is_doubted() -> None:
    guess = from_yaw(0.01, np.array([-0.2, 0.1, 0.0])) @ MOTION
    free = align_structure(Structure(TARGET), Structure(SOURCE), guess, LIDAR.agreement, 10.0)
    held = align_structure(Structure(TARGET), Structure(SOURCE), guess, LIDAR.agreement, 1e-4)
    np.testing.assert_allclose(free[:2, 3], MOTION[:2, 3], atol=0.03)
    np.testing.assert_allclose(held, guess, atol=2e-3)


@pytest.mark.parametrize("speed_mps", [-10.0, 0.0, 20.0, 45.0])
def test_the_search_finds_the_motion_without_a_guess(speed_mps: float) -> None:
    motion = gentle_bend(speed_mps or 1e-9)(0.2)
    source = prepared(points_at(motion, 5), 0.0).structure.xyz_m
    starts = search_motion(TARGET, source, np.eye(4), Reach(12.0, 0.2), LIDAR.search)
    away_m = [float(np.linalg.norm(start[:2, 3] - motion[:2, 3])) for start in starts]
    assert min(away_m) < 0.75
    assert len(starts) <= LIDAR.search.candidates


def test_the_search_stays_within_reach_and_needs_points() -> None:
    starts = search_motion(TARGET, SOURCE, np.eye(4), Reach(2.0, 0.1), LIDAR.search)
    assert max(float(np.linalg.norm(start[:2, 3])) for start in starts) <= 2.0
    assert search_motion(TARGET, np.zeros((0, 3)), np.eye(4), Reach(2.0, 0.1), LIDAR.search) == []


def test_without_points_nothing_is_measured() -> None:
    empty = Structure(np.zeros((0, 3)))
    found = measure_agreement(empty, Structure(SOURCE), np.eye(4), LIDAR.agreement)
    assert not found.is_measured
    assert np.isnan(found.rmse_m())
    assert found.sigmas == (float("inf"), float("inf"))
    np.testing.assert_array_equal(align_structure(empty, empty, MOTION, LIDAR.agreement, 1.0), MOTION)


def test_upright_is_what_holds_several_heights_above_its_foot() -> None:
    xyz = np.array(
        [
            [10.2, 3.2, -1.7],
            [10.4, 3.3, -1.2],
            [10.3, 3.4, 0.4],
            [20.2, 3.2, -1.7],
            [20.3, 3.2, -1.6],
            [90, 0, 0],
        ]
    )
    assert find_upright(xyz, LIDAR.structure).tolist() == [False, True, True, False, False, False]
    assert not find_upright(np.zeros((0, 3)), LIDAR.structure).size


def test_the_first_point_of_each_voxel_is_kept() -> None:
    xyz = np.array([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9], [-0.1, 0.1, 0.1], [0.2, 0.2, 0.2], [1.1, 0, 0]])
    assert first_in_voxels(xyz, 1.0).tolist() == [0, 2, 4]
