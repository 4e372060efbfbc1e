"""What was seen of a place once is known of it at other times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from upvl_cli.config.toml import load
from upvl_cli.perception.background.masks import UNKNOWN
from upvl_cli.perception.background.place_memory import PlaceMemory
from upvl_cli.stages.mask import MaskConfig

CONFIG = load(MaskConfig, Path(__file__).parents[3] / "stages" / "mask.toml").place_memory
RADIUS_M = CONFIG.radius_m
WALL = np.column_stack([np.linspace(0, 10, 200), np.full(200, 5.0), np.tile([0.5, 1.5], 100)])
CAR = np.column_stack([np.linspace(20, 24, 100), np.full(100, 5.0), np.full(100, 1.0)])


def fitted(sweeps: list[tuple[np.ndarray, np.ndarray]]) -> PlaceMemory:
    return PlaceMemory.fit(sweeps, CONFIG)


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
