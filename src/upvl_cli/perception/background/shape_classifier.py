"""What no camera ever saw, told by what looks like it to the LiDAR.

The points that a camera saw teach what background looks like without colours: how high it stands and how its
surface runs. The rest of the drive is told by that (an addition to UP-VL, where a point without a feature is kept;
the idea is that of its detector, which learns from LiDAR what the cameras told).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.voxels import voxelize
from upvl_cli.types import Array, Floats, Ints

VOXEL_M = 0.3
NEAR_M = 0.8  # a surface is looked at this far around: a car's door, not the whole car
COLUMN_M, AROUND_M = 0.5, 1.0  # what stands how high within a step of a place
LESSONS = 20_000  # places that teach: more no longer change the answer
FEWEST = 100  # places of each state, with fewer nothing is learned
ROUNDS = 60


class Shapes(NamedTuple):
    """What a sweep looks like.

    Attributes:
        of_point: (n,) number of the place that each point is in.
        look: (m, 8) float32 of each place: height, how much like a line, a sheet and a bush its surroundings are,
            how level, the highest and lowest heights around it, and the logarithm of how many places are near.
    """

    of_point: Ints
    look: Floats


def shapes(xyz_m: Floats, height_m: Floats) -> Shapes:
    """Look at the surroundings of each point.

    Args:
        xyz_m: (n, 3) points of one sweep that stand above the ground.
        height_m: (n,) their heights over the ground.
    """
    places = voxelize(xyz_m.reshape(-1, 3), voxel_m=VOXEL_M)
    total = len(places.weight)
    if not total:
        return Shapes(places.of_point, np.zeros((0, 8), dtype=np.float32))
    height = np.bincount(places.of_point, height_m, total) / places.weight
    near, spread, level = _surfaces(places.centroid)
    low, high = _columns(places.centroid[:, :2], height)
    longest = spread[:, 2]
    line, sheet = (longest - spread[:, 1]) / longest, (spread[:, 1] - spread[:, 0]) / longest
    columns = (height, line, sheet, spread[:, 0] / longest, level, high, low, np.log(near))
    return Shapes(places.of_point, np.stack(columns, axis=1).astype(np.float32))


def _surfaces(xyz_m: Floats) -> tuple[Ints, Floats, Floats]:
    """(m,) places near each, (m, 3) how far they spread along their own axes, ascending, and how level they lie."""
    total = len(xyz_m)
    left, right = _pairs(xyz_m, NEAR_M)
    near = np.bincount(left, minlength=total)

    def mean(values: Floats) -> Floats:
        return np.bincount(left, values, total) / near

    apart = xyz_m[right] - xyz_m[left]
    centre = [mean(apart[:, axis]) for axis in range(3)]
    spread = np.empty((total, 3, 3))
    for a in range(3):
        for b in range(a + 1):
            spread[:, a, b] = spread[:, b, a] = mean(apart[:, a] * apart[:, b]) - centre[a] * centre[b]
    values, axes = np.linalg.eigh(spread)
    return near, np.sqrt(np.maximum(values, 1e-6)), np.abs(axes[:, 2, 0])


def _columns(xy_m: Floats, height_m: Floats) -> tuple[Floats, Floats]:
    """(m,) lowest and highest height around each place."""
    columns = voxelize(xy_m, voxel_m=COLUMN_M)
    left, right = _pairs(columns.centroid, AROUND_M)
    low, high = np.full(len(columns.weight), np.inf), np.full(len(columns.weight), -np.inf)
    np.minimum.at(low, columns.of_point, height_m)
    np.maximum.at(high, columns.of_point, height_m)
    around_low, around_high = low.copy(), high.copy()
    np.minimum.at(around_low, left, low[right])
    np.maximum.at(around_high, left, high[right])
    return around_low[columns.of_point], around_high[columns.of_point]


def _pairs(points: Floats, radius_m: float) -> tuple[Ints, Ints]:
    """All ordered pairs of points within a radius, each with itself among them."""
    one, other = cKDTree(points).query_pairs(radius_m, output_type="ndarray").T
    itself = np.arange(len(points))
    return np.concatenate([one, other, itself]), np.concatenate([other, one, itself])


class Alike:
    """Tells background by shape, as the points that a camera saw have taught."""

    def __init__(self, lessons: Sequence[tuple[Floats, Ints]]) -> None:
        """Learn.

        Args:
            lessons: As of `lessons`, for each sweep of a drive.
        """
        from sklearn.ensemble import HistGradientBoostingClassifier

        look = np.concatenate([np.zeros((0, 8), np.float32), *(of for of, _ in lessons)])
        state = np.concatenate([np.zeros(0, np.int8), *(of for _, of in lessons)])
        step = max(1, -(-len(state) // LESSONS))
        self._rule = None
        if np.bincount(state[::step], minlength=2).min() >= FEWEST:
            rule = HistGradientBoostingClassifier(max_iter=ROUNDS, early_stopping=False, random_state=0)
            self._rule = rule.fit(look[::step], state[::step])

    def of(self, sweep: Shapes) -> Array:
        """(n,) int8: 1 where a point looks like background, 0 where not, `UNKNOWN` where nothing was learned."""
        if self._rule is None or not len(sweep.look):
            return np.full(len(sweep.of_point), UNKNOWN, dtype=np.int8)
        return np.asarray(self._rule.predict(sweep.look), dtype=np.int8)[sweep.of_point]


def lessons(sweep: Shapes, background: Ints) -> tuple[Floats, Ints]:
    """(k, 8) looks of the places of a sweep whose state is known, and (k,) whether most of each is background.

    Args:
        sweep: What it looks like.
        background: (n,) 1 where a camera saw background, 0 where not, `UNKNOWN` where none looked.
    """
    total = len(sweep.look)
    known = background != UNKNOWN
    count = np.bincount(sweep.of_point[known], minlength=total)
    share = np.bincount(sweep.of_point[known], background[known], total) / np.maximum(count, 1)
    return sweep.look[count > 0], (share[count > 0] >= 0.5).astype(np.int8)
