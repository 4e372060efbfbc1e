"""Triangles with surfaces, and the simple forms that everything in the city is built from.

Axes are those of the thing: x forward, y left, z up, the origin on the ground below its middle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from upvl_cli.synthetic.surface import Finish
from upvl_cli.types import Array, Floats, Ints

Triple = tuple[float, float, float]
Pair = tuple[float, float]


@dataclass(frozen=True)
class Mesh:
    """Triangles; the front of each is where its corners go counter-clockwise.

    Attributes:
        corner_m: (v, 3) places.
        face: (f, 3) numbers of corners.
        surface: (f,) place in `surfaces` of each face.
        surfaces: What the faces are made of.
    """

    corner_m: Floats
    face: Ints
    surface: Ints
    surfaces: tuple[Finish, ...]

    def moved(self, shift_m: Triple, yaw_rad: float = 0.0) -> Mesh:
        """Return the same, turned about the vertical and then moved."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return Mesh(self.corner_m @ turn.T + np.array(shift_m), self.face, self.surface, self.surfaces)

    def tilted(self, pitch_rad: float, pivot_m: Triple) -> Mesh:
        """Return the same, turned about the left-pointing axis through a place: positive lowers the front."""
        cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
        turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
        pivot = np.array(pivot_m)
        return Mesh((self.corner_m - pivot) @ turn.T + pivot, self.face, self.surface, self.surfaces)


def of(corner_m: Array, face: Array, surface: Finish) -> Mesh:
    """Return a mesh of one surface."""
    faces = np.asarray(face, dtype=np.int64).reshape(-1, 3)
    return Mesh(np.asarray(corner_m, np.float64), faces, np.zeros(len(faces), np.int64), (surface,))


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Several meshes as one."""
    parts = list(meshes)
    surfaces = list(dict.fromkeys(surface for part in parts for surface in part.surfaces))
    number = {surface: place for place, surface in enumerate(surfaces)}
    first = np.cumsum([0, *(len(part.corner_m) for part in parts)])
    return Mesh(
        np.concatenate([np.zeros((0, 3)), *(part.corner_m for part in parts)]),
        np.concatenate(
            [
                np.zeros((0, 3), np.int64),
                *(part.face + start for part, start in zip(parts, first[:-1], strict=True)),
            ]
        ),
        np.concatenate(
            [
                np.zeros(0, np.int64),
                *(np.array([number[surface] for surface in part.surfaces])[part.surface] for part in parts),
            ]
        ),
        tuple(surfaces),
    )


def box(size_lwh_m: Triple, centre_m: Triple, surface: Finish, yaw_rad: float = 0.0) -> Mesh:
    """Return a block."""
    length, width, height = size_lwh_m
    return prism(
        [
            (-length / 2, -height / 2),
            (length / 2, -height / 2),
            (length / 2, height / 2),
            (-length / 2, height / 2),
        ],
        width,
        surface,
    ).moved(centre_m, yaw_rad)


def prism(outline_xz_m: Sequence[Pair], width_m: float, surface: Finish, inset_m: float = 0.0) -> Mesh:
    """Return a side view drawn out across, symmetrical to the left and right.

    Args:
        outline_xz_m: Convex or star-shaped about its mean, counter-clockwise with x right and z up.
        width_m: Full width.
        surface: Of all its faces.
        inset_m: How much narrower each side is at the highest point than at the lowest: a cabin's slant.
    """
    outline = np.array(outline_xz_m, dtype=np.float64)
    low, high = outline[:, 1].min(), outline[:, 1].max()
    half = width_m / 2 - inset_m * (outline[:, 1] - low) / max(high - low, 1e-9)
    total = len(outline)
    # The outline once on the right (y < 0), once on the left, and the middles of both sides.
    corners = np.empty((2 * total + 2, 3))
    corners[:total, [0, 2]] = corners[total : 2 * total, [0, 2]] = outline
    corners[:total, 1], corners[total : 2 * total, 1] = -half, half
    corners[-2], corners[-1] = corners[:total].mean(axis=0), corners[total : 2 * total].mean(axis=0)
    return of(corners, _prism_faces(total), surface)


@cache
def _prism_faces(total: int) -> Ints:
    here = np.arange(total)
    after = (here + 1) % total
    return np.concatenate(
        [
            np.column_stack([here, after, np.full(total, 2 * total)]),
            np.column_stack([after + total, here + total, np.full(total, 2 * total + 1)]),
            np.column_stack([here, here + total, after]),
            np.column_stack([after, here + total, after + total]),
        ]
    )


def tube(
    start_m: Triple,
    end_m: Triple,
    radius_m: float,
    surface: Finish,
    *,
    end_radius_m: float | None = None,
    sides: int = 10,
) -> Mesh:
    """Return a round bar between two places, or a cone where its ends differ."""
    start, end = np.array(start_m), np.array(end_m)
    along = (end - start) / np.sqrt(((end - start) ** 2).sum())
    helper = np.eye(3)[np.abs(along).argmin()]
    one = _crossed(along, helper)
    one /= np.sqrt((one**2).sum())
    ring = _circle(sides) @ np.array([one, _crossed(along, one)])
    last_m = radius_m if end_radius_m is None else end_radius_m
    corners = np.concatenate([start + radius_m * ring, end + last_m * ring, [start, end]])
    return of(corners, _tube_faces(sides), surface)


def _crossed(a: Floats, b: Floats) -> Floats:
    """Return the cross product of two vectors, without numpy's overhead."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@cache
def _circle(sides: int) -> Floats:
    angle = np.arange(sides) * 2 * np.pi / sides
    return np.column_stack([np.cos(angle), np.sin(angle)])


@cache
def _tube_faces(sides: int) -> Ints:
    here = np.arange(sides)
    after = (here + 1) % sides
    return np.concatenate(
        [
            np.column_stack([here, after, here + sides]),
            np.column_stack([after, after + sides, here + sides]),
            np.column_stack([after, here, np.full(sides, 2 * sides)]),
            np.column_stack([here + sides, after + sides, np.full(sides, 2 * sides + 1)]),
        ]
    )


def ellipsoid(size_m: Triple, centre_m: Triple, surface: Finish, *, sides: int = 10) -> Mesh:
    """Return a ball, or what is left of one that was pressed."""
    corners, faces = _ball(sides)
    return of(corners * np.array(size_m) / 2 + np.array(centre_m), faces, surface)


@cache
def _ball(sides: int) -> tuple[Floats, Ints]:
    """Corners and faces of a ball of radius 1."""
    rows = max(sides // 2, 3)
    polar = np.arange(1, rows) * np.pi / rows
    circle = _circle(sides)
    ring = np.stack(
        [
            np.sin(polar)[:, None] * circle[:, 0],
            np.sin(polar)[:, None] * circle[:, 1],
            np.repeat(np.cos(polar)[:, None], sides, axis=1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    here = np.arange(sides)
    after = (here + 1) % sides
    top, bottom = len(ring), len(ring) + 1
    faces = [np.column_stack([np.full(sides, top), here, after])]
    for row in range(rows - 2):
        above, below = row * sides, (row + 1) * sides
        faces += [
            np.column_stack([here + above, here + below, after + above]),
            np.column_stack([after + above, here + below, after + below]),
        ]
    last = (rows - 2) * sides
    faces.append(np.column_stack([here + last, np.full(sides, bottom), after + last]))
    return np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]]), np.concatenate(faces)


def sheet(corner_m: Array, surface: Finish) -> Mesh:
    """Return a grid of (n, m, 3) places as a surface; its front is where rows x columns point."""
    rows, columns = np.asarray(corner_m).shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]).reshape(-1, 3)
    return of(np.asarray(corner_m).reshape(-1, 3), faces, surface)
