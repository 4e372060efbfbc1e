"""What a thing of the city is made of: rigid parts, of which some swing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from upvl_cli.synthetic.mesh import Mesh, Triple, joined

STRIDE_HZ_PER_MPS = 0.75  # double steps a second of a walker at 1 m/s; faster ones step more often
STAND_M = 0.01  # every thing stands this far above the ground, so that no two faces lie in one plane


class Part(NamedTuple):
    """A rigid part.

    Attributes:
        mesh: Its triangles, in the axes of the thing.
        swing_rad: How far it swings to the front and back while the thing moves; 0 for none.
        pivot_m: What it swings about: the axis to the left through this place.
        phase_rad: Where in its swing it is at time 0.
    """

    mesh: Mesh
    swing_rad: float = 0.0
    pivot_m: Triple = (0.0, 0.0, 0.0)
    phase_rad: float = 0.0


class ObjectModel(NamedTuple):
    """A thing, and the box that holds it at rest and in full swing.

    Attributes:
        size_lwh_m: Length, width and height of the box, which stands on the ground around the origin.
        parts: What it is made of.
    """

    size_lwh_m: Triple
    parts: tuple[Part, ...]


def model(parts: Sequence[Part | Mesh]) -> ObjectModel:
    """Put parts together, so that their box lies around the origin and they stand just above the ground."""
    whole = [part if isinstance(part, Part) else Part(part) for part in parts]
    rigid = [part.mesh for part in whole if not part.swing_rad]
    swinging = [part for part in whole if part.swing_rad]
    reached = [
        part.mesh.tilted(sign * part.swing_rad, part.pivot_m).corner_m
        for part in swinging
        for sign in (-1, 0, 1)
    ]
    corners = np.concatenate([*(mesh.corner_m for mesh in rigid), *reached])
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y = (float(v) for v in -(low + high)[:2] / 2)
    shift: Triple = (x, y, STAND_M - float(low[2]))
    moved = [
        Part(
            part.mesh.moved(shift),
            part.swing_rad,
            (part.pivot_m[0] + shift[0], part.pivot_m[1] + shift[1], part.pivot_m[2] + shift[2]),
            part.phase_rad,
        )
        for part in swinging
    ]
    if rigid:
        moved.insert(0, Part(joined(rigid).moved(shift)))
    length, width, height = (float(v) for v in high - low)
    return ObjectModel((length, width, height + STAND_M), tuple(moved))
