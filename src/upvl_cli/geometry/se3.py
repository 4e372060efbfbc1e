"""Rigid transforms as 4 x 4 matrices, named `dst_from_src`: they take coordinates of src to dst."""

from __future__ import annotations

import numpy as np

from upvl_cli.types import Array


def inverse(a_from_b: Array) -> Array:
    """Return `b_from_a`, by the transpose of the rotation.

    Args:
        a_from_b: (..., 4, 4) rigid transforms.
    """
    a_from_b = np.asarray(a_from_b, dtype=np.float64)
    rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    b_from_a = np.zeros_like(a_from_b)
    b_from_a[..., :3, :3] = rotation
    b_from_a[..., :3, 3] = -(rotation @ a_from_b[..., :3, 3:])[..., 0]
    b_from_a[..., 3, 3] = 1.0
    return b_from_a


def apply(dst_from_src: Array, xyz: Array) -> Array:
    """Return the points in the axes of dst, float64: world coordinates do not fit float32.

    Args:
        dst_from_src: (..., 4, 4) rigid transforms.
        xyz: (..., n, 3) points in the axes of src, in metres.
    """
    dst_from_src = np.asarray(dst_from_src, dtype=np.float64)
    rotation = np.swapaxes(dst_from_src[..., :3, :3], -1, -2)
    return np.asarray(xyz, dtype=np.float64) @ rotation + dst_from_src[..., None, :3, 3]


def from_yaw(yaw_rad: Array | float, translation_m: Array) -> Array:
    """Return the transform of an upright body that stands at a place with a heading.

    Args:
        yaw_rad: (...) headings, counter-clockwise from x.
        translation_m: (..., 3) places.
    """
    translation_m = np.asarray(translation_m, dtype=np.float64)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    shape = np.broadcast_shapes(np.shape(yaw_rad), translation_m.shape[:-1])
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., 0, 0] = matrix[..., 1, 1] = cos
    matrix[..., 1, 0], matrix[..., 0, 1] = sin, -sin
    matrix[..., 2, 2] = matrix[..., 3, 3] = 1.0
    matrix[..., :3, 3] = translation_m
    return matrix


def yaw_of(dst_from_src: Array) -> Array:
    """Return the heading in dst of the x axis of src, in radians.

    Args:
        dst_from_src: (..., 4, 4) rigid transforms.
    """
    matrix = np.asarray(dst_from_src, dtype=np.float64)
    return np.asarray(np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]))


def wrap_angle(rad: Array | float) -> Array:
    """Return the angles in [-pi, pi); those that are there already keep every bit.

    Args:
        rad: (...) angles.
    """
    rad = np.asarray(rad, dtype=np.float64)
    wrapped = np.remainder(rad + np.pi, 2 * np.pi) - np.pi
    wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)  # remainder can round up to 2 pi
    return np.where((rad >= -np.pi) & (rad < np.pi), rad, wrapped)
