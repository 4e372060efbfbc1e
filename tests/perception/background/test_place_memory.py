"""What was seen of a place once is known of it at other times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from upvl_cli.config.toml import load
from upvl_cli.perception import voxels as voxel_grid
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.background.place_memory import PlaceMemory, PlaceSums
from upvl_cli.perception.voxels import voxelize
from upvl_cli.stages.mask import MaskConfig

CONFIG = load(MaskConfig, Path(__file__).parents[3] / "stages" / "mask.toml").place_memory
RADIUS_M = CONFIG.radius_m
WALL = np.column_stack([np.linspace(0, 10, 200), np.full(200, 5.0), np.tile([0.5, 1.5], 100)])
CAR = np.column_stack([np.linspace(20, 24, 100), np.full(100, 5.0), np.full(100, 1.0)])


def fitted(sweeps: list[tuple[np.ndarray, np.ndarray]]) -> PlaceMemory:
    sums = PlaceSums(CONFIG)
    for xyz, is_background in sweeps:
        sums.add(xyz, is_background)
    return sums.memory()


def test_each_place_has_the_state_that_most_sweeps_saw() -> None:
    both = np.concatenate([WALL, CAR])
    is_wall = np.arange(len(both)) < len(WALL)
    memory = fitted([(both, is_wall), (both, is_wall), (both, np.ones(len(both), bool))])  # one errs
    shifted = 0.04
    assert (memory.lookup(WALL + shifted) == 1).all()
    assert (memory.lookup(CAR + shifted) == 0).all()


def test_of_other_places_nothing_is_known() -> None:
    memory = fitted([(WALL, np.ones(len(WALL), bool))])
    assert (memory.lookup(WALL + [0, 2 * RADIUS_M + 0.3, 0]) == UNKNOWN).all()
    assert memory.lookup(np.zeros((0, 3))).shape == (0,)
    assert (fitted([]).lookup(CAR) == UNKNOWN).all()


def test_sweeps_count_with_their_points() -> None:
    """Nine points of one sweep outvote one point of each of two others, in the same voxel."""
    spot = np.full((9, 3), 0.1)
    memory = fitted([(spot, np.ones(9, bool)), (spot[:1], np.zeros(1, bool)), (spot[:1], np.zeros(1, bool))])
    assert memory.share.tolist() == [9 / 11]
    assert memory.lookup(spot[:1]).tolist() == [1]


def test_half_of_the_points_make_a_place_background() -> None:
    spot = np.full((2, 3), 0.1)
    assert fitted([(spot, np.array([True, False]))]).lookup(spot).tolist() == [1, 1]
    three = np.full((3, 3), 0.1)
    assert fitted([(three, np.array([True, False, False]))]).lookup(spot).tolist() == [0, 0]


def test_a_place_reaches_as_far_as_its_radius() -> None:
    memory = fitted([(np.full((1, 3), 0.1), np.ones(1, bool))])
    away = np.full((2, 3), 0.1)
    away[:, 0] += RADIUS_M - 0.01, RADIUS_M + 0.01
    assert memory.lookup(away).tolist() == [1, UNKNOWN]


def test_the_nearest_place_counts() -> None:
    points = np.array([[0.1, 0.1, 0.1], [0.6, 0.1, 0.1]])
    memory = fitted([(points, np.array([True, False]))])
    assert memory.lookup(np.array([[0.3, 0.1, 0.1], [0.4, 0.1, 0.1]])).tolist() == [1, 0]


@pytest.mark.parametrize("fewest", [1, 300, 10**6])
def test_sums_are_those_of_all_sweeps_at_once_to_the_bit(
    fewest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plain way keeps the voxels of every sweep; places far from the origin, as in a map's axes."""
    monkeypatch.setattr(voxel_grid, "_FEWEST_TO_MERGE", fewest)
    rng = np.random.default_rng(0)
    sweeps = [
        (rng.uniform(0, 3, (200, 3)) + [4.0e5 + number / 9, 5.6e6, -3], rng.random(200) < 0.6)
        for number in range(20)
    ]
    each = [voxelize(xyz, voxel_m=CONFIG.voxel_m) for xyz, _ in sweeps]
    places = voxelize(np.concatenate([voxels.centroid for voxels in each]), voxel_m=CONFIG.voxel_m)
    total = len(places.weight)
    points = np.bincount(places.of_point, np.concatenate([voxels.weight for voxels in each]), total)
    hits = [
        np.bincount(voxels.of_point, is_background)
        for voxels, (_, is_background) in zip(each, sweeps, strict=True)
    ]
    memory = fitted(sweeps)
    np.testing.assert_array_equal(memory.tree.data, places.centroid)
    np.testing.assert_array_equal(
        memory.share, np.bincount(places.of_point, np.concatenate(hits), total) / points
    )


def test_the_sums_are_as_large_as_the_places_and_not_as_the_sweeps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(voxel_grid, "_FEWEST_TO_MERGE", 1)
    sums = PlaceSums(CONFIG)
    for _ in range(100):
        sums.add(WALL, np.ones(len(WALL), bool))
    places = fitted([(WALL, np.ones(len(WALL), bool))]).tree.n
    assert sum(len(cells) for cells, _ in sums._background._parts) <= 3 * places
