"""Patterns of surfaces: how bright a place is beside the plain colour of its surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from upvl_cli.types import Array, Floats

Pattern = Callable[[Floats, Floats], Floats]


def brightness(texture: str, local_m: Array, normal: Array) -> Floats:
    """(n,) factor on the colour.

    Args:
        texture: A key of `TEXTURES`.
        local_m: (n, 3) places in the axes of their thing.
        normal: (n, 3) unit normals, which tell the two directions along the surface.
    """
    level = np.abs(normal[:, 2]) > 0.7
    # Along a wall u is level and v upright; on the ground u and v are x and y.
    across = np.where(np.abs(normal[:, 0]) > np.abs(normal[:, 1]), local_m[:, 1], local_m[:, 0])
    u = np.where(level, local_m[:, 0], across)
    v = np.where(level, local_m[:, 1], local_m[:, 2])
    return TEXTURES[texture](u, v)


def _random(i: Array, j: Array, seed: int) -> Floats:
    """Return a number from 0 to 1 for each cell of a grid, always the same one."""
    mixed = i.astype(np.uint32) * np.uint32(0x9E3779B1) ^ j.astype(np.uint32) * np.uint32(0x85EBCA77)
    mixed = (mixed ^ np.uint32(seed * 0x27D4EB2F & 0xFFFFFFFF)) * np.uint32(0xC2B2AE3D)
    mixed ^= mixed >> np.uint32(15)
    mixed *= np.uint32(0x2C1B3C6D)
    return np.asarray((mixed >> np.uint32(8)) / np.float64(1 << 24))


def _cells(u: Floats, v: Floats, size_m: float, seed: int) -> Floats:
    return _random(np.floor(u / size_m).astype(np.int64), np.floor(v / size_m).astype(np.int64), seed)


def _smooth(u: Floats, v: Floats, size_m: float, seed: int) -> Floats:
    """Cells that run into each other."""
    x, y = u / size_m, v / size_m
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    a, b = x - i, y - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    low = _random(i, j, seed) * (1 - a) + _random(i + 1, j, seed) * a
    high = _random(i, j + 1, seed) * (1 - a) + _random(i + 1, j + 1, seed) * a
    return np.asarray(low * (1 - b) + high * b)


def _courses(u: Floats, v: Floats, length_m: float, height_m: float, joint_m: float) -> Floats:
    """Stones in courses, each of its own shade, with dark joints."""
    row = np.floor(v / height_m)
    shifted = u + 0.5 * length_m * (row % 2)
    column = np.floor(shifted / length_m)
    joint = (v - row * height_m < joint_m) | (shifted - column * length_m < joint_m)
    shade = 0.85 + 0.3 * _random(column.astype(np.int64), row.astype(np.int64), 7)
    return np.asarray(np.where(joint, 0.72, shade))


def _asphalt(u: Floats, v: Floats) -> Floats:
    return 0.78 + 0.2 * _cells(u, v, 0.04, 1) + 0.24 * _smooth(u, v, 2.5, 2)


def _worn(u: Floats, v: Floats) -> Floats:
    return 0.82 + 0.2 * _smooth(u, v, 0.25, 3)


def _concrete(u: Floats, v: Floats) -> Floats:
    return 0.85 + 0.12 * _cells(u, v, 0.06, 4) + 0.15 * _smooth(u, v, 1.5, 5)


def _plaster(u: Floats, v: Floats) -> Floats:
    return 0.92 + 0.06 * _cells(u, v, 0.05, 6) + 0.08 * _smooth(u, v, 2.0, 7)


def _grass(u: Floats, v: Floats) -> Floats:
    return 0.6 + 0.45 * _cells(u, v, 0.07, 8) + 0.35 * _smooth(u, v, 1.2, 9)


def _leaves(u: Floats, v: Floats) -> Floats:
    return 0.45 + 0.6 * _cells(u, v, 0.11, 10) + 0.4 * _smooth(u, v, 0.5, 11)


def _bark(u: Floats, v: Floats) -> Floats:
    return 0.7 + 0.5 * _cells(u, v * 0.2, 0.05, 12)


def _planks(u: Floats, v: Floats) -> Floats:
    return 0.8 + 0.3 * _cells(u, v * 0.01, 0.14, 13)


def _cloth(u: Floats, v: Floats) -> Floats:
    return 0.88 + 0.2 * _smooth(u, v, 0.12, 14)


TEXTURES: dict[str, Pattern] = {
    "plain": lambda u, v: np.ones(len(u)),
    "asphalt": _asphalt,
    "worn": _worn,
    "concrete": _concrete,
    "slabs": lambda u, v: _courses(u, v, 0.5, 0.5, 0.015) * (0.9 + 0.15 * _cells(u, v, 0.05, 15)),
    "grass": _grass,
    "bricks": lambda u, v: _courses(u, v, 0.25, 0.08, 0.012),
    "plaster": _plaster,
    "planks": _planks,
    "tiles": lambda u, v: _courses(u, v, 0.3, 0.3, 0.03),
    "bark": _bark,
    "leaves": _leaves,
    "cloth": _cloth,
}
