"""How things move: upright on the ground, along ways that are sampled evenly in time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from upvl_cli.types import Array, Floats

SAMPLE_HZ = 20
STRAIGHT_RAD = 3e-4  # who turns less than this meanwhile does not turn: 2 mm at the end of a bus


class Placed(NamedTuple):
    """Where something is at n times; what is the same at all of them has length 1.

    Attributes:
        rotation: (n, 3, 3) from its axes to the world's.
        place_m: (n, 3) its origin in world axes.
        odometer_m: (n,) how far it has gone.
    """

    rotation: Floats
    place_m: Floats
    odometer_m: Floats

    def world(self, local_m: Array) -> Floats:
        """(n, 3) world places of one local place at each time."""
        return np.asarray(self.outward(local_m) + self.place_m.astype(local_m.dtype))

    def local(self, world_m: Array) -> Floats:
        """(n, 3) the inverse of `world`."""
        return self.inward(world_m - self.place_m.astype(world_m.dtype))

    def outward(self, way: Array) -> Floats:
        """(n, 3) local directions in world axes."""
        if len(self.rotation) == 1:
            return np.asarray(way @ self.rotation[0].T.astype(way.dtype))
        return np.asarray(np.einsum("nij,nj->ni", self.rotation, way))

    def inward(self, way: Array) -> Floats:
        """(n, 3) world directions in local axes."""
        if len(self.rotation) == 1:
            return np.asarray(way @ self.rotation[0].astype(way.dtype))
        return np.asarray(np.einsum("nji,nj->ni", self.rotation, way))

    def chosen(self, index: Array) -> Placed:
        """At some of the times only."""
        return Placed(*(values if len(values) == 1 else values[index] for values in self))


@dataclass(frozen=True)
class Motion:
    """A way over the ground; a thing that stands has one sample.

    Attributes:
        place_m: (k, 3) origin at the times 0, 1 / SAMPLE_HZ, ...
        heading_rad: (k,) without jumps.
        slope: (k, 2) rise of the ground ahead and to the left, of the metre.
        first_s: Time of the first sample.
    """

    place_m: Floats
    heading_rad: Floats
    slope: Floats
    first_s: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether it is ever anywhere else."""
        return len(self.place_m) > 1

    @cached_property
    def _odometer_m(self) -> Floats:
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.place_m, axis=0), axis=1)))

    def place_at(self, time_s: float) -> Floats:
        """(3,) the place alone, at one time."""
        step = (time_s - self.first_s) * SAMPLE_HZ
        low = min(max(int(step), 0), max(len(self.place_m) - 2, 0))
        share = min(max(step - low, 0.0), 1.0) if self.moves else 0.0
        return np.asarray(self.place_m[low] + share * (self.place_m[low + self.moves] - self.place_m[low]))

    def at(self, time_s: Array) -> Placed:
        """Where it is at the (n,) times; before the first sample and after the last one it stands."""
        if not self.moves:
            return Placed(rotations(self.heading_rad, self.slope), self.place_m, np.zeros(1))
        time = np.asarray(time_s, dtype=np.float64)
        if len(time) and (time == time[0]).all():
            time = time[:1]
        step = np.clip((time - self.first_s) * SAMPLE_HZ, 0, len(self.place_m) - 1)
        low = np.minimum(step.astype(np.int64), len(self.place_m) - 2)
        share = (step - low)[:, None]
        place, slope = (v[low] + share * (v[low + 1] - v[low]) for v in (self.place_m, self.slope))
        heading, odometer = (
            v[low] + share[:, 0] * (v[low + 1] - v[low]) for v in (self.heading_rad, self._odometer_m)
        )
        if len(heading) and np.ptp(heading) < STRAIGHT_RAD and np.ptp(slope, axis=0).max() < STRAIGHT_RAD:
            heading, slope = heading.mean(keepdims=True), slope.mean(axis=0, keepdims=True)
        return Placed(rotations(heading, slope), place, odometer)


def rotations(heading_rad: Array, slope: Array) -> Floats:
    """(n, 3, 3) from the axes of what stands on a slope to the world's.

    Args:
        heading_rad: (n,) where it looks to.
        slope: (n, 2) rise of the ground ahead and to the left.
    """
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    ahead = np.stack([cos, sin, slope[:, 0]], axis=1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.stack([-sin, cos, slope[:, 1]], axis=1)
    left -= np.einsum("ni,ni->n", left, ahead)[:, None] * ahead
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    return np.stack([ahead, left, np.cross(ahead, left)], axis=2)
