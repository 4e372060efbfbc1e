"""Thinned sweeps: few enough points, evenly in space."""

from __future__ import annotations

import numpy as np

from upvl_cli.viewer.thinning import evenly_thinned


def test_few_points_are_all_kept_and_many_are_thinned_to_the_number() -> None:
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-50, 50, (5000, 3))
    assert evenly_thinned(xyz, 5000).tolist() == list(range(5000))
    assert evenly_thinned(np.zeros((0, 3)), 10).tolist() == []
    kept = evenly_thinned(xyz, 1000)
    assert 500 < len(kept) <= 1000
    assert (np.diff(kept) > 0).all()
    assert evenly_thinned(xyz, 1000).tolist() == kept.tolist()


def test_a_lone_point_far_away_outlives_a_heap_nearby() -> None:
    rng = np.random.default_rng(0)
    heap = rng.normal(0, 0.2, (10_000, 3))
    alone = np.array([[60.0, 0, 0], [0, 70.0, 1], [-80.0, 3, 2]])
    kept = evenly_thinned(np.concatenate([heap, alone]), 200)
    assert {10_000, 10_001, 10_002} <= set(kept.tolist())


def test_points_in_one_place_end_the_search() -> None:
    assert evenly_thinned(np.ones((100, 3)), 1).tolist() == [0]
    assert len(evenly_thinned(np.array([[-900.0, 0, 0], [900.0, 0, 0], [900.0, 1, 0]]), 1)) == 1
