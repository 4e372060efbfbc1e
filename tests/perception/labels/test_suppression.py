"""Scores of labels by their likeness and their points, and sizes that no object has."""

from __future__ import annotations

import numpy as np
import pytest

from upvl_cli.perception.labels.config import BoxScoreConfig, SizeConfig
from upvl_cli.perception.labels.suppression import box_score, size_faults
from upvl_cli.types import Boxes

SCORE = BoxScoreConfig(half_points=5.0)
SIZE = SizeConfig(min_volume_m3=0.1, max_volume_m3=200.0, min_height_m=0.3)


@pytest.mark.parametrize(
    ("size", "reason"),
    [
        ((4, 2, 1.5), None),
        ((30, 2.6, 2.5), None),  # 195 m^3: a tram
        ((0.5, 0.5, 1.7), None),  # a walker
        ((4, 2, 0.2), "too flat"),
        ((0.3, 0.3, 0.5), "too small"),
        ((20, 10, 3), "too large"),
        ((0.1, 0.1, 0.1), "too flat"),  # and too small: one reason is enough
        ((4, 2, 0.3), None),  # the limits themselves
        ((0.5, 0.4, 0.5), None),
        ((10, 10, 2), None),
        ((np.nan, 2, 1.5), "too small"),
        ((4, 2, np.nan), "too flat"),
    ],
)
def test_sizes(size: tuple[float, float, float], reason: str | None) -> None:
    faults = size_faults(Boxes(np.zeros((1, 3)), np.array([size]), np.zeros(1)), SIZE)
    assert [name for name, faulty in faults.items() if faulty[0]] == ([reason] if reason else [])


def test_more_points_are_a_higher_score_up_to_the_objectness() -> None:
    score = box_score(np.full(4, 0.8), np.array([0, 5, 50, 10**9]), np.zeros(4), SCORE)
    np.testing.assert_allclose(score[[0, 1, 3]], [0, 0.4, 0.8])
    assert (np.diff(score) > 0).all()


def test_background_lowers_the_score() -> None:
    score = box_score(np.full(3, 0.5), np.full(3, 50), np.array([0.0, 0.5, 1.0]), SCORE)
    np.testing.assert_allclose(score, score[0] * np.array([1, 0.5, 0]))


def test_no_box_has_no_score() -> None:
    assert box_score(np.zeros(0), np.zeros(0, int), np.zeros(0), SCORE).shape == (0,)
