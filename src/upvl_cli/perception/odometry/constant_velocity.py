"""Motion at constant velocity: the logarithm and exponential of rigid transforms, by time and not by frames."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from upvl_cli.geometry.se3 import compose, inverse
from upvl_cli.types import Array, Floats

_SMALL_RAD = 1e-8  # below, the series of the left Jacobian is its first two terms in every digit


def velocity_between(world_from_first: Array, world_from_second: Array, seconds: float) -> Floats:
    """Return the (6,) twist that leads from one pose to another: the logarithm of SE(3) over the time.

    Barfoot, State Estimation for Robotics, section 7.1: velocity (m/s) and turn rate (rad/s) along the body's axes.

    Args:
        world_from_first: (4, 4) pose.
        world_from_second: (4, 4) pose `seconds` later.
        seconds: Time between them, not 0.
    """
    motion = compose(inverse(world_from_first), world_from_second)
    turn_rad = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    translation_m = np.linalg.solve(_left_jacobian(turn_rad), motion[:3, 3])
    return np.concatenate([translation_m, turn_rad]) / seconds


def motion_over(twist: Floats, seconds: float) -> Floats:
    """Return the (4, 4) motion of a body with a constant (6,) twist over a time: the exponential of SE(3).

    Args:
        twist: (6,) velocity (m/s) and turn rate (rad/s) along the body's axes.
        seconds: How long it moves; below 0 for back in time.
    """
    turn_rad = twist[3:] * seconds
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(turn_rad).as_matrix()
    motion[:3, 3] = _left_jacobian(turn_rad) @ (twist[:3] * seconds)
    return motion


def pose_between(poses: Array, times_s: Floats, time_s: float) -> Floats:
    """Return the (4, 4) pose at a time, on the screw motion between two poses or beyond them.

    Args:
        poses: (2, 4, 4) poses.
        times_s: (2,) their times.
        time_s: The time.
    """
    twist = velocity_between(poses[0], poses[1], float(times_s[1] - times_s[0]))
    return compose(poses[0], motion_over(twist, float(time_s - times_s[0])))


def compensate_motion(xyz_m: Floats, offset_s: Floats, twist: Floats) -> Floats:
    """Return (n, 3) static places as seen from where the body stood at the time 0, to second order.

    Args:
        xyz_m: (n, 3) places, each in the body's axes of the moment at which it was measured.
        offset_s: (n,) these moments.
        twist: (6,) velocity (m/s) and turn rate (rad/s) along the body's axes.
    """
    first = twist[:3] + np.cross(twist[3:], xyz_m)
    second = np.cross(twist[3:], first)
    moved: Floats = xyz_m + offset_s[:, None] * (first + 0.5 * offset_s[:, None] * second)
    return moved


def _left_jacobian(turn_rad: Floats) -> Floats:
    """(3, 3) of a rotation vector: it takes the integrated velocity to the translation."""
    angle = float(np.linalg.norm(turn_rad))
    x, y, z = turn_rad
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < _SMALL_RAD:
        return np.eye(3) + 0.5 * skew
    first = (1 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    jacobian: Floats = np.eye(3) + first * skew + second * (skew @ skew)
    return jacobian
