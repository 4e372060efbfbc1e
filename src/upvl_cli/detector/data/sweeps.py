"""Two sweeps as one cloud of points, and what is known of it, before and after it becomes a `Sample`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from upvl_cli.detector.batch import Grid, Sample
from upvl_cli.geometry.boxes import pairs_inside
from upvl_cli.geometry.se3 import apply, inverse
from upvl_cli.types import Array, Floats, Ints, Points

_LONGEST_S = 0.5  # an older sweep says no more of where things are
_LEARNED_FEATURES = 8192  # of a frame: ten times as many took half of the time of a step and taught the same
_VOXEL_M = 0.2  # the older sweep keeps a point of each voxel: near the car it would be half of all points


@dataclass(frozen=True)
class Route:
    """Where and when the sweeps of a drive were taken.

    Attributes:
        frames: Numbers of the frames.
        time_ns: Time of each.
        world_from_ego: (T, 4, 4) pose of each.
        ground_z_m: Height of the road in ego axes; the detector sees heights above it, whatever the car.
    """

    frames: tuple[int, ...]
    time_ns: tuple[int, ...]
    world_from_ego: Floats
    ground_z_m: float

    def points(self, place: int, sweep: Callable[[int], Points]) -> Array:
        """Return (n, 6) points as in `Sample`, heights above the road: a sweep, then the one before it, thinned.

        Args:
            place: Which of `frames`.
            sweep: Gives the points of the frame of that number.
        """
        pieces = [_columns(sweep(self.frames[place]), 0.0)]
        since_s = (self.time_ns[place - 1] - self.time_ns[place]) * 1e-9 if place else -np.inf
        if since_s >= -_LONGEST_S:
            before = _columns(sweep(self.frames[place - 1]), since_s)
            before = before[_thinned(before[:, :3])]
            now_from_before = inverse(self.world_from_ego[place]) @ self.world_from_ego[place - 1]
            before[:, :3] = apply(now_from_before, before[:, :3])
            pieces.append(before)
        points = np.concatenate(pieces)
        points[:, 2] -= self.ground_z_m
        return points


def _columns(points: Points, time_s: float) -> Array:
    return np.column_stack(
        [
            points.xyz_ego_m,
            points.intensity,
            points.elongation,
            np.full(len(points), time_s, dtype=np.float32),
        ]
    )


def _thinned(xyz_m: Array) -> Ints:
    """Return the first point of each voxel, in the order of the points."""
    cell = np.floor(xyz_m / _VOXEL_M).astype(np.int64) + 2**20  # 21 bits an axis: 400 km
    key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
    return np.sort(np.unique(key, return_index=True)[1])


@dataclass(frozen=True)
class Scene:
    """Two sweeps with their labels, as they are changed for training.

    Attributes:
        points: (n, 6) as in `Sample`.
        code_of: (n,) row of `codes` that belongs to each point, -1 where none does.
        codes: (c, 64) int8 features of the points that a camera sees.
        boxes: (m, 7) labels, heights above the road.
        velocity_mps: (m, 3) their velocities over the ground along the ego axes.
    """

    points: Array
    code_of: Ints
    codes: Ints
    boxes: Floats
    velocity_mps: Floats

    def sample(self, grid: Grid, values: Callable[[Ints], Floats], rng: np.random.Generator) -> Sample:
        """Return what lies in the grid, as the network takes it, with the features of some of the points.

        Args:
            grid: What the network sees.
            values: Gives the kept values of codes.
            rng: Chance, which chooses the points whose features are learned from.
        """
        inside = grid.holds(self.points)
        learned = self._learned(np.flatnonzero(inside & (self.code_of >= 0)), rng)
        feature = values(self.codes[self.code_of[learned]])
        seen = (np.cumsum(inside) - 1)[learned]
        return Sample(self.points[inside].astype(np.float32, copy=False), self.boxes, seen, feature)

    def _learned(self, seen: Ints, rng: np.random.Generator) -> Ints:
        """Return some of the points, ascending: half of them in boxes, where there are any, and half anywhere.

        Small things have few points and would hardly count. A box counts as the root of its points, by repetition.
        """
        box, held = pairs_inside(self.points[seen, :3], self.boxes, margin_m=0.0)
        each = 1 / np.sqrt(np.bincount(box)[box])
        in_boxes = rng.choice(seen[held], _LEARNED_FEATURES // 2, p=each / each.sum()) if len(held) else held
        rest = _LEARNED_FEATURES - len(in_boxes)
        anywhere = rng.choice(seen, rest, replace=False, shuffle=False) if len(seen) > rest else seen
        return np.sort(np.concatenate([in_boxes, anywhere]))


def scene(points: Array, seen: Ints, codes: Ints, boxes: Floats, velocity_mps: Floats) -> Scene:
    """Return a scene from what the stages say of its frame.

    Args:
        points: (n, 6) from `Route.points`.
        seen: (c,) the points of this sweep that a camera sees.
        codes: (c, 64) their features.
        boxes: (m, 7) labels, heights above the road.
        velocity_mps: (m, 3) their velocities.
    """
    code_of = np.full(len(points), -1, dtype=np.int32)
    code_of[seen] = np.arange(len(seen))
    return Scene(points, code_of, codes, boxes, velocity_mps)
