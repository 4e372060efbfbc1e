"""Refinement of given poses by odometry: roughness goes, axes and shape over long times stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from perception.still_scene import SETTINGS, gentle_bend
from upvl_cli.geometry.se3 import compose, from_yaw, inverse, yaw_of
from upvl_cli.perception.odometry.refinement import fit_slowly, refine_poses

CONFIG = replace(SETTINGS.refinement, averaging_s=5.0)
TIME_S = np.arange(100) / 10
TRUE = np.array([compose(from_yaw(0.7, np.array([300.0, -20, 5])), gentle_bend(8.0)(t)) for t in TIME_S])
ODOMETRY = compose(inverse(TRUE[0]), TRUE)


def rounded(poses: np.ndarray) -> np.ndarray:
    """Positions to 1.1 m, as latitudes of five decimals give them."""
    rough = poses.copy()
    rough[:, :2, 3] = np.round(poses[:, :2, 3] / 1.1) * 1.1
    return rough


def step_errors_m(poses: np.ndarray) -> np.ndarray:
    steps, true = (compose(inverse(each[:-1]), each[1:])[:, :3, 3] for each in (poses, TRUE))
    return np.linalg.norm(steps - true, axis=1)


def test_rounded_positions_come_out_smooth_and_in_the_axes_of_the_given_ones() -> None:
    given = rounded(TRUE)
    found = refine_poses(given, ODOMETRY, TIME_S, CONFIG)
    assert found.agrees
    assert step_errors_m(given).max() > 0.5
    assert step_errors_m(found.world_from_ego).max() < 0.02
    assert np.linalg.norm(found.world_from_ego[:, :3, 3] - TRUE[:, :3, 3], axis=1).max() < 0.3
    np.testing.assert_allclose(yaw_of(found.world_from_ego), yaw_of(TRUE), atol=1e-6)


def test_drift_of_odometry_is_taken_out() -> None:
    """1 % too long and turning by 0.03 degrees a second: refined it is 10 cm off where it was 1 m."""
    drift = np.array([from_yaw(0.0005 * t, np.zeros(3)) for t in TIME_S])
    drifted = compose(drift, ODOMETRY)
    drifted[:, :3, 3] *= 1.01
    found = refine_poses(TRUE, drifted, TIME_S, CONFIG).world_from_ego
    assert np.linalg.norm(found[:, :3, 3] - TRUE[:, :3, 3], axis=1).max() < 0.15


def test_one_wrong_record_changes_nothing() -> None:
    given = TRUE.copy()
    given[40, 0, 3] += 3.0
    given[60, :3, :3] = from_yaw(2.0, np.zeros(3))[:3, :3]
    found = refine_poses(given, ODOMETRY, TIME_S, CONFIG)
    assert found.agrees
    np.testing.assert_allclose(found.world_from_ego[:, :3, 3], TRUE[:, :3, 3], atol=0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        np.tile(TRUE[:1], (100, 1, 1)),
        np.array([from_yaw(-yaw_of(pose), pose[:3, 3] * [1, -1, 1]) for pose in TRUE]),
    ],
    ids=["the first record repeated", "mirrored"],
)
def test_a_path_of_another_shape_gives_no_more_than_its_start(wrong: np.ndarray) -> None:
    found = refine_poses(wrong, ODOMETRY, TIME_S, CONFIG)
    assert not found.agrees
    assert step_errors_m(found.world_from_ego).max() < 0.01


def test_one_pose_stays() -> None:
    np.testing.assert_array_equal(
        refine_poses(TRUE[:1], ODOMETRY[:1], TIME_S[:1], CONFIG).world_from_ego, TRUE[:1]
    )


def test_a_line_is_fitted_exactly_at_uneven_times() -> None:
    time_s = np.array([0, 0.1, 0.5, 2.0, 2.1, 7.0])
    line = np.column_stack([3 * time_s - 1, 0.5 * time_s])
    np.testing.assert_allclose(fit_slowly(line, time_s, 5.0), line, atol=1e-6)
