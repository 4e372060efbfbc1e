"""Poses, axes and motion compensation against the sweeps: each cause once, and drives that are right."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from moving_world import FRAMES, RATE_HZ, config, path, sample, turned

from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import from_yaw, inverse, yaw_of
from upvl_cli.perception.drive_check.finding import Finding
from upvl_cli.perception.drive_check.motion_check import check_motion
from upvl_cli.perception.drive_check.motion_survey import MotionSurvey, survey_motion
from upvl_cli.types import Array

TRUE = path()
TIMES_NS = [step * 10**9 // RATE_HZ for step in range(FRAMES)]


@cache
def survey() -> MotionSurvey:
    """Return the motion by the sweeps of the drive that is right: poses do not change it."""
    return survey_motion(sample(TRUE), config())


def findings(claimed: Array | None = None) -> list[Finding]:
    return list(check_motion(sample(TRUE, claimed=claimed), config(), survey(), is_quick=True))


def about(found: list[Finding], subject: str) -> str:
    return " | ".join(f"{item.level}: {item.sentence}" for item in found if item.subject == subject)


def moved(change: Callable[[Array], Array]) -> Array:
    poses = TRUE.copy()
    poses[:, :3, 3] = change(poses[:, :3, 3])
    return poses


def headed(change: Callable[[Array], Array]) -> Array:
    return from_yaw(change(yaw_of(TRUE)), TRUE[:, :3, 3])


def with_axes(turn: list[list[int]]) -> Array:
    poses = TRUE.copy()
    poses[:, :3, :3] = poses[:, :3, :3] @ np.array(turn).T
    return poses


def delayed(seconds: float) -> Array:
    return np.array([pose_at(TIMES_NS, TRUE, time - round(seconds * 1e9)) for time in TIMES_NS])


def jumped() -> Array:
    poses = TRUE.copy()
    poses[12, 1, 3] += 3.0
    return poses


def noisy() -> Array:
    return moved(lambda xyz: np.column_stack([np.rint(xyz[:, :2] / 1.1) * 1.1, xyz[:, 2]]))


def test_a_drive_that_is_right() -> None:
    found = findings()
    assert [item.level for item in found] == ["ok", "ok"], about(found, "poses")


def test_a_car_that_stands() -> None:
    still = np.tile(TRUE[:1], (FRAMES, 1, 1))
    found = list(check_motion(sample(still, runs=2, length=2), config()))
    assert [item.level for item in found] == ["cannot tell", "ok", "cannot tell"]


@pytest.mark.parametrize("frames", [1, 2])
def test_short_drives(frames: int) -> None:
    found = list(check_motion(sample(TRUE[:frames]), config()))
    assert {item.level for item in found} <= {"ok", "cannot tell"}


def test_a_drive_without_poses() -> None:
    part = sample(TRUE, runs=2, length=2)
    object.__setattr__(part, "world_from_ego", None)
    assert {item.level for item in check_motion(part, config(), is_quick=True)} == {"ok"}


@pytest.mark.parametrize(
    ("claimed", "words"),
    [
        (inverse(TRUE), "ego_from_world"),
        (moved(lambda xyz: xyz * [1, -1, 1]), "path is mirrored"),
        (moved(lambda xyz: xyz[:, [1, 0, 2]]), "path is mirrored"),
        (headed(lambda yaw: np.pi / 2 - yaw), "wrong sense"),
        (headed(lambda yaw: np.degrees(yaw)), "degrees"),
        (headed(lambda yaw: np.radians(yaw)), "radians where degrees"),
        (moved(lambda xyz: xyz / 0.3048), "in feet"),
        (moved(lambda xyz: xyz / 1000), "in kilometres"),
        (with_axes([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), 'pose_axes = ["y", "-x", "z"]'),
        (with_axes([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), 'pose_axes = ["z", "-x", "-y"]'),
        (np.tile(TRUE[:1], (FRAMES, 1, 1)), "one record is repeated"),
        (TRUE[np.arange(FRAMES) // 2 * 2], "lower rate"),
        (jumped(), "jumps in 2 of 23 steps"),
        (noisy(), "rounded"),
        (delayed(0.1), "late"),
        (delayed(-0.3), "early"),
        (TRUE[::-1], "opposite order"),
    ],
    ids=[
        "inverse", "mirrored", "swapped", "clockwise", "degrees", "radians", "feet", "kilometres", "y-forward",
        "camera", "constant", "half-rate", "jump", "rounded", "late", "early", "reversed",
    ],
)  # fmt: skip
def test_a_fault_of_poses_is_named(claimed: Array, words: str) -> None:
    found = [item for item in findings(claimed=claimed) if item.subject == "poses"]
    bad = [item for item in found if item.level in ("warning", "fault")]
    assert any(words in item.sentence for item in bad), about(found, "poses")


@pytest.mark.parametrize(
    ("matrix", "subject", "words"),
    [
        ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], "axes", 'axes = ["y", "-x", "z"]'),
        ([[0, -1, 0], [0, 0, -1], [1, 0, 0]], "axes", 'axes = ["z", "-x", "-y"]'),
        ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], "axes", 'axes = ["x", "-y", "-z"]'),
        ([[-1, 0, 0], [0, -1, 0], [0, 0, 1]], "poses", 'set axes = ["-x", "-y", "z"]'),
        ([[1, 0, 0], [0, -1, 0], [0, 0, 1]], "poses", "-y"),
        (np.eye(3) / 0.3048, "poses", "metres_per_unit = 0.3048"),
        (np.eye(3) * 100, "poses", "metres_per_unit = 0.01"),
        (from_yaw(0.7, np.zeros(3))[:3, :3], "axes", "off its axis"),
    ],
    ids=["y-forward", "camera", "z-down", "half-turn", "mirrored", "feet", "centimetres", "oblique"],
)
def test_a_fault_of_points_is_named(matrix: Array, subject: str, words: str) -> None:
    part = sample(TRUE, change=turned(np.asarray(matrix)), runs=4, length=3)
    found = list(check_motion(part, config(), is_quick=True))
    bad = [item for item in found if item.subject == subject and item.level == "fault"]
    assert any(words in item.sentence for item in bad), about(found, subject)


def test_a_mirror_in_the_rotation_is_no_pose() -> None:
    poses = TRUE.copy()
    poses[3, :3, 1] *= -1
    found = list(check_motion(sample(TRUE, claimed=poses, runs=1, length=2), config(), is_quick=True))
    assert "1 of 24 poses are no rotation" in about(found, "poses") and "left-handed" in about(found, "poses")


def test_the_same_findings_every_time() -> None:
    first, second = (list(check_motion(sample(TRUE, runs=1), config(), is_quick=True)) for _ in range(2))
    assert first == second
