"""Rigid transforms as 4 x 4 matrices, named `dst_from_src`: they take coordinates of src to dst.

No product goes through BLAS, whose last digit depends on the processor: see `geometry.small_matrices`.
"""

from __future__ import annotations

import numpy as np

from upvl_cli.geometry.small_matrices import product
from upvl_cli.types import Array

_MANY = 1000  # vectors from which on a pass for each row of the matrix is quicker than three over all numbers


def inverse(a_from_b: Array) -> Array:
    """Return `b_from_a`, by the transpose of the rotation.

    Args:
        a_from_b: (..., 4, 4) rigid transforms.
    """
    a_from_b = np.asarray(a_from_b, dtype=np.float64)
    rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    b_from_a = np.zeros_like(a_from_b)
    b_from_a[..., :3, :3] = rotation
    b_from_a[..., :3, 3] = -product(rotation, a_from_b[..., :3, 3:])[..., 0]
    b_from_a[..., 3, 3] = 1.0
    return b_from_a


def apply(dst_from_src: Array, xyz: Array) -> Array:
    """Return the points in the axes of dst, float64: world coordinates do not fit float32.

    Args:
        dst_from_src: (..., 4, 4) rigid transforms.
        xyz: (..., n, 3) points in the axes of src, in metres.
    """
    dst_from_src = np.asarray(dst_from_src, dtype=np.float64)
    moved = rotate(dst_from_src, xyz)
    moved += dst_from_src[..., None, :3, 3]
    return moved


def rotate(dst_from_src: Array, vectors: Array) -> Array:
    """Return the vectors along the axes of dst, float64: a transform without its translation.

    Args:
        dst_from_src: (..., 4, 4) rigid transforms.
        vectors: (..., n, 3) vectors along the axes of src.
    """
    matrix, vectors = np.asarray(dst_from_src, dtype=np.float64), np.asarray(vectors, dtype=np.float64)
    # Either way each number is (x a + y b) + z c: one order of summation on every processor.
    if vectors.shape[-2] < _MANY:
        rotated = vectors[..., 0, None] * matrix[..., None, :3, 0]
        rotated += vectors[..., 1, None] * matrix[..., None, :3, 1]
        rotated += vectors[..., 2, None] * matrix[..., None, :3, 2]
        return np.asarray(rotated)
    x, y, z = (vectors[..., axis] for axis in range(3))
    rotated = np.empty((*np.broadcast_shapes((*matrix.shape[:-2], 1), x.shape), 3))
    for row in range(3):
        total = x * matrix[..., row, 0, None]
        total += y * matrix[..., row, 1, None]
        total += z * matrix[..., row, 2, None]
        rotated[..., row] = total
    return rotated


def compose(a_from_b: Array, b_from_c: Array) -> Array:
    """Return `a_from_c`, which applies `b_from_c` first.

    Args:
        a_from_b: (..., 4, 4) rigid transforms.
        b_from_c: (..., 4, 4) rigid transforms.
    """
    return product(np.asarray(a_from_b, dtype=np.float64), np.asarray(b_from_c, dtype=np.float64))


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
