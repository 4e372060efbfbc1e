"""The car's pose between frames, and a little before and after them."""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.path import pose_at
from upvl_cli.geometry.se3 import from_yaw, yaw_of

TIMES_NS = [0, 100, 300]
POSES = from_yaw(np.array([0.0, 0.2, 0.2]), np.array([[0.0, 0, 0], [2, 1, 0], [4, 1, 0]]))


def test_frames_have_their_own_poses() -> None:
    for time_ns, pose in zip(TIMES_NS, POSES, strict=True):
        np.testing.assert_allclose(pose_at(TIMES_NS, POSES, time_ns), pose, atol=1e-12)


def test_between_frames_place_and_heading_go_on_evenly() -> None:
    pose = pose_at(TIMES_NS, POSES, 50)
    np.testing.assert_allclose(pose[:3, 3], [1, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(yaw_of(pose), 0.1, atol=1e-12)


def test_beyond_the_frames_the_motion_goes_on() -> None:
    np.testing.assert_allclose(pose_at(TIMES_NS, POSES, 400)[:3, 3], [5, 1, 0], atol=1e-12)
    np.testing.assert_allclose(yaw_of(pose_at(TIMES_NS, POSES, -50)), -0.1, atol=1e-12)


def test_one_frame_is_all_there_is() -> None:
    np.testing.assert_array_equal(pose_at([7], POSES[:1], 99), POSES[0])
